"""What is done ahead: depth maps, links and a growing surface, with the result of a batch run."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from polhode.config import Config
from polhode.pipeline.live.session import Session
from polhode.records.dataset import open_sequence
from polhode.records.surface import SurfaceModel
from polhode.run_directory.stages import DEPTH
from polhode.runtime.processes import kill_workers
from tests.pipeline.conftest import ONE_METHOD

CONFIG = Config.model_validate({**ONE_METHOD, "runtime": {"workers": 2}})
SAME = ("trajectory.csv", "landmarks.ply", "mesh.ply")


@pytest.fixture(scope="module")
def finished(
    rendered_sequence: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[SurfaceModel], tuple[int, int], int]:
    """The run of a session in which everything was done ahead; surfaces halfway and at the end; depth maps
    and links that were made ahead; landmarks at the end."""
    sequence, folder = open_sequence(rendered_sequence), tmp_path_factory.mktemp("ahead") / "run"
    surfaces, time_s = [], (sequence.timestamps_ns - sequence.timestamps_ns[0]) * 1e-9
    with Session(CONFIG, sequence.calibration) as session:
        for k in range(len(sequence)):
            pair = sequence.read_pair(k)
            session.push(pair.left, pair.right, float(time_s[k]))
            if k in (len(sequence) // 2, len(sequence) - 1):
                surface = session.surface()
                assert surface is not None
                surfaces.append(surface)
        landmarks = len(session.landmarks_G)
        ahead = session._stream._ahead
        assert ahead is not None
        made = sum(ahead.depth.has(DEPTH, str(k)) for k in range(len(sequence))), len(ahead.finish())
        stored = ahead.depth.folder
        assert stored is not None
        session.finish(folder)
        assert stored.is_dir()
    assert not stored.exists()
    return folder, surfaces, made, landmarks


def test_without_the_process_the_stream_goes_on(rendered_sequence: Path) -> None:
    sequence = open_sequence(rendered_sequence)
    pair = sequence.read_pair(0)
    with Session(CONFIG, sequence.calibration) as session:
        session.push(pair.left, pair.right, 0.0)
        assert session.surface() is not None
        kill_workers()
        assert session.surface() is None
        state = session.push(pair.right, pair.left, 0.5)
        assert state is not None and state.number == 1
        assert session.surface() is None


def test_the_answer_is_that_of_a_batch_run(
    finished: tuple[Path, list[SurfaceModel], tuple[int, int], int],
    rendered_sequence: Path,
    run_of_one_method: Path,
) -> None:
    run_folder, _, (depth_maps, links), _ = finished
    n = len(open_sequence(rendered_sequence))
    assert depth_maps == n and links > 0
    # the names of the files differ, and so the recorded data; what is measured and found does not
    found, batch = (
        np.loadtxt(each / "trajectory.csv", delimiter=",", skiprows=1)
        for each in (run_folder, run_of_one_method)
    )
    np.testing.assert_array_equal(found[:, 1:], batch[:, 1:])
    for name in ("landmarks.ply", "mesh.ply"):
        assert (run_folder / name).read_bytes() == (run_of_one_method / name).read_bytes(), name


def test_the_surface_grows_towards_the_final_one(
    finished: tuple[Path, list[SurfaceModel], tuple[int, int], int],
) -> None:
    run_folder, (half, whole), _, landmarks = finished
    assert 0 < half.mesh.area < whole.mesh.area
    final = trimesh.load(run_folder / "mesh.ply")
    assert isinstance(final, trimesh.Trimesh)
    assert abs(whole.mesh.area / final.area - 1.0) < 0.2
    np.testing.assert_allclose(whole.mesh.extents, final.extents, rtol=0.1)
    assert landmarks > 50
