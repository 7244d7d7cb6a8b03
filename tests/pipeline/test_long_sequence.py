"""A sequence above the number of frames that are solved at once: key frames, then all states."""

from pathlib import Path

import numpy as np
import pytest

from polhode.config import Config
from polhode.config.loader import load_config
from polhode.errors import InputError
from polhode.pipeline.context import open_context
from polhode.pipeline.long_sequence import stream_sequence
from polhode.pipeline.run import run
from polhode.pipeline.run_directory.archives import read_measurements, read_online
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.trajectory_file import read_trajectory
from polhode.progress import Silent
from tests.pipeline.conftest import ONE_METHOD

LIMITS = {"above": 10, "number": 9}
CONFIG = Config.model_validate({**ONE_METHOD, "key_frames": LIMITS})


@pytest.fixture(scope="module")
def long_run(rendered_sequence: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("long") / "run"
    run(CONFIG, rendered_sequence, folder, Silent())
    return folder


def test_every_frame_has_its_row(long_run: Path, rendered_sequence: Path) -> None:
    context = open_context(rendered_sequence, CONFIG, Silent())
    times_ns = context.sequence.timestamps_ns
    np.testing.assert_array_equal(read_trajectory(long_run).timestamps_ns, times_ns)
    online = read_online(long_run)
    assert online is not None
    np.testing.assert_array_equal(online.timestamps_ns, times_ns)
    assert read_measurements(long_run).n_frames == len(times_ns)
    summary = read_summary(long_run)
    assert summary.frames == len(times_ns)
    assert (long_run / "mesh.ply").is_file()


def test_the_answer_is_that_of_all_frames_at_once(long_run: Path, run_of_one_method: Path) -> None:
    few, all_frames = read_trajectory(long_run), read_trajectory(run_of_one_method)
    sigma = np.hypot(few.sigma_r, all_frames.sigma_r)
    off = np.abs(few.r_N - all_frames.r_N) / sigma
    assert np.mean(off < 3.0) > 0.95


def test_only_key_frames_keep_their_features(rendered_sequence: Path) -> None:
    streamed = stream_sequence(open_context(rendered_sequence, CONFIG, Silent()))
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
