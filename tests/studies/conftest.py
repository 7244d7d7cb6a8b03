"""Small studies, and a cluster within the process of the tests, which starts in a moment."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import yaml
from distributed import Client

from polhode.runtime.progress import Silent
from polhode.studies import sweep as flow
from polhode.studies.cluster import Cluster, ClusterOptions
from polhode.studies.study import open_study
from polhode.studies.table import TIME, read_table

SCENE: dict[str, Any] = {
    "frames": 1,
    "truth_horizon_s": 0,
    "rig": {"width_px": 48, "height_px": 36, "focal_px": 35.0},
    "motion": {"position_m": [0.04, 0.0, 0.6]},
    "light": {"earth": 0.0},
    "render": {"samples": 1, "bounces": 0},
}
"""One pair of images, rendered in a tenth of a second"""
BASELINES = "scene.rig.baseline_m"

WriteStudy = Callable[..., Path]
Sweep = Callable[..., flow.Swept]


def timeless(folder: Path) -> pa.Table:
    """The table without what differs between two computations."""
    table = read_table(folder)
    return table.select([name for name in table.column_names if not name.startswith(TIME)])


@pytest.fixture
def write_study(tmp_path: Path) -> WriteStudy:
    """A study's file with these keys."""

    def write(name: str = "study", **content: Any) -> Path:
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return write


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    with Client(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None, set_as_default=False
    ) as client:
        yield client


def thread_of(client: Client) -> Callable[..., AbstractContextManager[Cluster]]:
    """In place of ``opened_cluster``: the only worker is a thread of this process."""

    @contextmanager
    def opened(options: ClusterOptions, folder: Path, inputs: Sequence[Path]) -> Iterator[Cluster]:
        del options, folder, inputs
        yield Cluster(client, 1, "a thread")

    return opened


@pytest.fixture
def sweep_here(client: Client, monkeypatch: pytest.MonkeyPatch) -> Sweep:
    """``polhode sweep`` whose only worker is a thread of this process."""

    def run(path: Path, folder: Path, again_failed: bool = False) -> flow.Swept:
        return flow.sweep(open_study(path), folder, Silent(), ClusterOptions(), again_failed)

    monkeypatch.setattr(flow, "opened_cluster", thread_of(client))
    return run
