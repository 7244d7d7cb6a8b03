"""A dataset is replaced whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from polhode.config.scene import Scene
from polhode.errors import InputError
from polhode.progress import Advance, Silent
from simulation.sequence import simulate

SCENE = Scene.model_validate(
    {
        "frames": 3,
        "truth_horizon_s": 1.0,
        "rig": {"width_px": 48, "height_px": 36, "focal_px": 35.0},
        "motion": {"position_m": [0.04, 0.0, 0.6]},
    }
)


class _Interrupted:
    """A listener that loses patience after the first frame."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        del title, total

        def advance() -> None:
            raise KeyboardInterrupt

        yield advance


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupted_rendering_leaves_the_old_dataset_as_it_was(tmp_path: Path, workers: int) -> None:
    simulate(SCENE, 4, tmp_path / "S", Silent())
    before = {p: p.read_bytes() for p in (tmp_path / "S").rglob("*") if p.is_file()}
    with pytest.raises(KeyboardInterrupt):
        simulate(SCENE, 5, tmp_path / "S", _Interrupted(), workers, overwrite=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["S"]


def test_replacing_leaves_nothing_of_the_old_dataset(tmp_path: Path) -> None:
    simulate(SCENE, 4, tmp_path / "S", Silent())
    shorter = SCENE.model_copy(update={"frames": 1})
    simulate(shorter, 4, tmp_path / "S", Silent(), overwrite=True)
    assert len(list((tmp_path / "S/mav0/cam0/data").iterdir())) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["S"]


def test_a_file_in_the_way_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "S").write_text("x")
    with pytest.raises(InputError, match="is a file"):
        simulate(SCENE, 4, tmp_path / "S", Silent(), overwrite=True)
    with pytest.raises(InputError, match="cannot be made"):
        simulate(SCENE, 4, tmp_path / "S" / "inside", Silent())
    assert (tmp_path / "S").read_text() == "x"
