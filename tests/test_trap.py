"""The trap of the other tests works: they would see code that is executed."""

import pickle  # noqa: TID251  to spring the trap
from pathlib import Path

from tests.trap import trap


def test_a_pickle_that_is_read_executes_code(tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    content = trap(sprung)
    assert not sprung.exists()
    pickle.loads(content)  # noqa: S301
    assert sprung.exists()
