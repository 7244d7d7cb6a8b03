"""What the front end made of a pair or of its matches, taken from the first run of the suite that made it.

Results of stages are stored under a digest of all that they depend on
(``polhode/run_directory/finished_stages.py``): what a run takes here is what it would have computed. Runs
whose front end is what is tested, or whose bytes are compared, compute theirs.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

import pytest

from polhode.run_directory.finished_stages import StageStore

FRONT_END = ("features", "matches", "depth")
"""Stages whose results are shared"""

SharedFrontEnd = Callable[[], AbstractContextManager[None]]


@contextmanager
def shared_front_end(folder: Path) -> Iterator[None]:
    """Runs of this process take what other runs have put into ``folder``, and put there what they made."""
    has, put = StageStore.has, StageStore.put

    def has_shared(store: StageStore, stage: str, key: str) -> bool:
        own = store._file(stage, key)
        if stage in FRONT_END and own is not None and not own.exists():
            own.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError):
                os.link(folder / stage / own.name, own)
        return has(store, stage, key)

    def put_shared(store: StageStore, stage: str, key: str, result: object) -> int:
        size, own = put(store, stage, key, result), store._file(stage, key)
        if stage in FRONT_END and own is not None:
            (folder / stage).mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):
                os.link(own, folder / stage / own.name)
        return size

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StageStore, "has", has_shared)
        patch.setattr(StageStore, "put", put_shared)
        yield
