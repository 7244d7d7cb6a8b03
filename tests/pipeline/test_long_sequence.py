"""A sequence above the number of frames that are solved at once: key frames, then all states."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from polhode.config import Config
from polhode.config.loader import load_config
from polhode.pipeline.run import run
from polhode.pipeline.stream.stream import Stream
from polhode.pipeline.stream_results import Streamed
from polhode.records.dataset import open_sequence
from polhode.run_directory.archives import read_measurements, read_online
from polhode.run_directory.summary import read_summary
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.front_end_results import SharedFrontEnd
from tests.pipeline.conftest import WITHOUT_NETWORKS

LIMITS = {"above": 10, "number": 9}
CONFIG = Config.model_validate({**WITHOUT_NETWORKS, "key_frames": LIMITS})


@dataclass(frozen=True)
class LongRun:
    """A run, and what it kept of the frames while they passed by."""

    folder: Path
    streamed: Streamed


@pytest.fixture(scope="module")
def long_run(
    rendered_sequence: Path, front_end_once: SharedFrontEnd, tmp_path_factory: pytest.TempPathFactory
) -> LongRun:
    folder, kept = tmp_path_factory.mktemp("long") / "run", list[Streamed]()

    def noted(stream: Stream, warnings: tuple[str, ...]) -> Streamed:
        kept.append(streamed(stream, warnings))
        return kept[-1]

    streamed = Stream.streamed
    with front_end_once(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stream, "streamed", noted)
        run(CONFIG, rendered_sequence, folder, Silent())
    return LongRun(folder, kept[0])


def test_every_frame_has_its_row(long_run: LongRun, rendered_sequence: Path) -> None:
    folder = long_run.folder
    times_ns = open_sequence(rendered_sequence).timestamps_ns
    np.testing.assert_array_equal(read_trajectory(folder).timestamps_ns, times_ns)
    online = read_online(folder)
    assert online is not None
    np.testing.assert_array_equal(online.timestamps_ns, times_ns)
    assert read_measurements(folder).n_frames == len(times_ns)
    summary = read_summary(folder)
    assert summary.frames == len(times_ns)
    assert (folder / "mesh.ply").is_file()


def test_the_answer_is_that_of_all_frames_at_once(long_run: LongRun, run_of_one_method: Path) -> None:
    few, all_frames = read_trajectory(long_run.folder), read_trajectory(run_of_one_method)
    sigma = np.hypot(few.sigma_r, all_frames.sigma_r)
    off = np.abs(few.r_N - all_frames.r_N) / sigma
    assert np.mean(off < 3.0) > 0.95


def test_only_key_frames_keep_their_features(long_run: LongRun) -> None:
    streamed = long_run.streamed
    assert len(streamed.features) == len(streamed.key_frames) < len(streamed.timestamps_ns)
    assert len(streamed.observations) == len(streamed.timestamps_ns)
    assert not streamed.tried
    for k, features in zip(streamed.key_frames, streamed.features, strict=True):
        assert len(streamed.observations[k].landmark) == len(features)
        np.testing.assert_array_equal(streamed.observations[k].uvd_px, features.uvd_px.astype(np.float32))


def test_more_key_frames_than_frames_at_once_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("key_frames: {above: 20, number: 30}\n", encoding="utf-8")
    with pytest.raises(InputError, match="30 key frames are more than above: 20"):
        load_config(file)
