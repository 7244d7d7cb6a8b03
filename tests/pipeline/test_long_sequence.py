"""A sequence above the number of frames that are solved at once: key frames, then all states."""

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
from tests.pipeline.conftest import ONE_METHOD


def test_every_frame_has_its_row_and_the_answer_is_that_of_all_frames_at_once(
    rendered_sequence: Path,
    run_of_one_method: Path,
    front_end_once: SharedFrontEnd,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, kept, streamed_of = tmp_path / "run", list[Streamed](), Stream.streamed

    def noted(stream: Stream, warnings: tuple[str, ...]) -> Streamed:
        kept.append(streamed_of(stream, warnings))
        return kept[-1]

    monkeypatch.setattr(Stream, "streamed", noted)
    config = Config.model_validate({**ONE_METHOD, "key_frames": {"above": 10, "number": 9}})
    with front_end_once():
        run(config, rendered_sequence, folder, Silent())
    times_ns = open_sequence(rendered_sequence).timestamps_ns
    few, all_frames, online = read_trajectory(folder), read_trajectory(run_of_one_method), read_online(folder)
    assert online is not None
    for each in (few, online):
        np.testing.assert_array_equal(each.timestamps_ns, times_ns)
    assert read_measurements(folder).n_frames == len(times_ns) == read_summary(folder).frames
    assert (folder / "mesh.ply").is_file()
    off = np.abs(few.r_N - all_frames.r_N) / np.hypot(few.sigma_r, all_frames.sigma_r)
    assert np.mean(off < 3.0) > 0.95
    # only key frames keep their features
    (streamed,) = kept
    assert len(streamed.features) == len(streamed.key_frames) < len(streamed.timestamps_ns)
    assert len(streamed.observations) == len(streamed.timestamps_ns) and not streamed.tried
    for k, features in zip(streamed.key_frames, streamed.features, strict=True):
        seen = streamed.observations[k]
        assert len(seen.landmark) == len(features)
        np.testing.assert_array_equal(seen.uvd_px, features.uvd_px.astype(np.float32))


def test_more_key_frames_than_frames_at_once_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("key_frames: {above: 20, number: 30}\n", encoding="utf-8")
    with pytest.raises(InputError, match="30 key frames are more than above: 20"):
        load_config(file)
