"""One thread for BLAS, as in the program; stereo sequences on disk, for tests to read and to damage."""

from polhode.runtime.threads import limit_threads

limit_threads(1)  # of what is imported below, and of NumPy, which a plugin of pytest has imported

# isort: split
import fcntl
import gc
import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_sensor
from polhode.runtime import processes

if TYPE_CHECKING:
    from tests.front_end_results import SharedFrontEnd

# The same examples in every run, on a machine of any speed, and nothing is kept between runs.
settings.register_profile("same", derandomize=True, database=None, deadline=None, max_examples=20)
settings.load_profile("same")

# As in a terminal: nohup ignores SIGHUP, a shell SIGINT for what it starts in the background, and what the
# tests start would inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

WIDTH_PX, HEIGHT_PX, BASELINE_M = 64, 48, 0.09
RENDERED_FRAMES = 14
TIMESTAMPS_NS = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(6, dtype=np.int64)

LONGEST = ("tests/test_package.py", "tests/pipeline/test_run.py", "tests/compare/test_truth.py")
"""Files that begin, so that at the end no process waits long for the other."""
SHARE_RUNS = ("tests/pipeline", "tests/cli", "tests/compare", "tests/docs", "tests/examples", "tests/studies")
"""Folders whose tests read the same runs: they follow in the same process, as another one would wait for what
it is making. The other process begins with the second half of all tests."""


def pytest_configure(config: pytest.Config) -> None:
    """What workers need is imported once for all tests of this process, as a run does, while they are found.

    The process that only hands out the tests to others (pytest-xdist) needs it not.
    """
    if not config.getoption("numprocesses", None):
        processes.start_server(("polhode.pipeline.run",), workers=2)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, then those that share runs; the order is kept otherwise."""
    items.sort(key=lambda item: (not item.nodeid.startswith(LONGEST), not item.nodeid.startswith(SHARE_RUNS)))


def pytest_collection_finish() -> None:
    """Modules stay: the garbage collector need not look at what they made again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def nothing_waits_for_the_disk() -> Iterator[None]:
    """No test loses power: that new content is on the disk before an old one is given up needs no wait."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


MakeOnce = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A temporary folder of all processes of the suite."""
    base = tmp_path_factory.getbasetemp()
    # with pytest-xdist every process has a folder of its own in one that they share
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session")
def make_once(shared: Path) -> MakeOnce:
    """A folder by its name, filled by the first process of the suite that asks for it; the others wait.

    Tests that change files take a copy of it.
    """

    def folder(name: str, fill: Callable[[Path], object]) -> Path:
        path, complete = shared / name, shared / f"{name}.complete"
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not complete.exists():
                fill(path)
                complete.touch()
        return path

    return folder


@pytest.fixture(scope="session")
def rendered_sequence(make_once: MakeOnce) -> Path:
    """A tumbling free flyer, RENDERED_FRAMES pairs of 320x256 px, with its truth and depth maps."""
    from polhode.config import Config
    from polhode.runtime.progress import Silent
    from polhode.simulation import simulate

    scene = {
        "frames": RENDERED_FRAMES,
        "interval_s": 0.5,
        "body": {"family": "free_flyer", "size_m": 0.22},
        "motion": {"position_m": [0.04, 0.0, 0.5], "spin_rpm": [3.0, 9.0, 2.0], "spin_axes": "principal"},
        "rig": {"width_px": 320, "height_px": 256, "focal_px": 288.0, "baseline_m": 0.09},
        "truth_horizon_s": 15.0,
        "render": {"products": ["depth"]},
    }
    found = Config.model_validate({"scene": scene}).scene
    assert found is not None
    return make_once("rendered", lambda folder: simulate(found, 3, folder, Silent(), 1, False))


@pytest.fixture(scope="session")
def front_end_once(shared: Path) -> "SharedFrontEnd":
    """In its context, runs take what the front end made of the same pairs in another run of the suite."""
    from tests.front_end_results import shared_front_end

    return partial(shared_front_end, shared / "front_end")


@pytest.fixture(scope="session")
def finished(rendered_sequence: Path, make_once: MakeOnce, front_end_once: "SharedFrontEnd") -> Path:
    """The directory of a run of the rendered sequence with the default configuration."""
    from polhode.config import Config
    from polhode.pipeline.run import run
    from polhode.runtime.progress import Silent

    config = Config.model_validate({"runtime": {"workers": 1}})
    with front_end_once():
        return make_once("finished", lambda folder: run(config, rendered_sequence, folder, Silent()))


@pytest.fixture
def coarse_keep_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep-out volumes have half the cells a side, which takes an eighth of the time."""
    from polhode.planning.keep_out.volumes import KeepOutOptions

    coarse = partial(KeepOutOptions, cells=KeepOutOptions.cells // 2)
    for user in ("polhode.planning.keep_out.volumes", "polhode.api"):
        monkeypatch.setattr(f"{user}.KeepOutOptions", coarse)


@pytest.fixture
def small_sequence(tmp_path: Path) -> Path:
    """Six pairs of 64x48 px: a bright random patch before black sky with sensor noise."""
    rng = np.random.default_rng(7)
    folder = tmp_path / "sequence"
    for index in (0, 1):
        camera = folder / "mav0" / f"cam{index}"
        K = np.array([[50.0, 0.0, 31.5], [0.0, 51.0, 23.5], [0.0, 0.0, 1.0]])
        X_BC = np.eye(4)
        X_BC[0, 3] = BASELINE_M * index
        write_sensor(camera, K, np.array([-0.1, 0.01, 0.0, 0.0]), X_BC, (WIDTH_PX, HEIGHT_PX), rate_hz=2.0)
        write_camera_csv(camera, TIMESTAMPS_NS)
        for stamp in TIMESTAMPS_NS:
            image = rng.normal(2.0, 1.0, (HEIGHT_PX, WIDTH_PX)).clip(0.0, 255.0)
            image[12:36, 20:44] = rng.integers(60, 250, (24, 24))
            write_png(image_path(camera, int(stamp)), image.astype(np.uint8))
    return folder
