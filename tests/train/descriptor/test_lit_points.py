"""Frames of one pose show the same surface in other light; bodies are rendered once."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from polhode.config.train_settings import Corpus, DescriptorTraining
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.train.descriptor.batches import PatchBatches
from polhode.train.descriptor.lit_points import lit_points_path, prepare_lit_points
from polhode.train.descriptor.scores import validation_pairs
from polhode.train.descriptor.surface_points import ScenePoints
from tests.train.descriptor.conftest import STUDY


def test_frames_of_one_pose_differ_in_their_light_alone(lit_points: ScenePoints) -> None:
    np.testing.assert_array_equal(lit_points.X_KG[0], lit_points.X_KG[2])
    assert not np.allclose(lit_points.X_KG[0], lit_points.X_KG[1])
    lit = (lit_points.grey[0] > 30) | (lit_points.grey[2] > 30)
    assert np.abs(lit_points.grey[0].astype(float) - lit_points.grey[2])[lit].mean() > 10.0
    # under another Sun the true place is the same pixel
    same = lit_points.frame[lit_points.point] % STUDY.poses == lit_points.other % STUDY.poses
    own = lit_points.uv_px[lit_points.point[same]]
    assert len(own) > 200
    np.testing.assert_allclose(lit_points.uv_other_px[same], own, atol=1e-4)
    assert lit_points.angle_rad[same].max() < 1e-6
    assert lit_points.angle_rad[~same].max() > np.deg2rad(10.0)


def test_pairs_that_differ_in_light_alone_are_learned_from_and_scored(lit_points: ScenePoints) -> None:
    trials = validation_pairs({0: lit_points}, 1)
    assert "light" in {trial.angle for trial in trials}
    exact = DescriptorTraining(
        batch=60, frame_pairs=6, normal_noise_deg=0.0, fronto_parallel=0.0, place_noise_px=0.0
    )
    batch = PatchBatches({0: lit_points}, exact, 1).batch(0)
    still = np.array([np.allclose(X, np.eye(4), atol=1e-6) for X in batch["X_AB"].numpy()])
    assert 0 < still.sum() < len(still)


def test_only_missing_bodies_are_rendered_and_a_damaged_file_is_refused(
    lit_corpus: Corpus, tmp_path: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(lit_corpus.folder, folder)
    corpus = lit_corpus.model_copy(update={"folder": str(folder)})
    path = lit_points_path(corpus, STUDY, 1)
    before = path.stat().st_mtime_ns
    assert sorted(prepare_lit_points(corpus, STUDY, Silent(), 1)) == [0, 1]
    assert path.stat().st_mtime_ns == before
    none = STUDY.model_copy(update={"bodies": 0})
    assert prepare_lit_points(corpus, none, Silent(), 1) == {}
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=r"remove this file, and it is made again"):
        prepare_lit_points(corpus, STUDY, Silent(), 1)
    other = corpus.model_copy(update={"turn_deg": (15.0, 40.0)})
    with pytest.raises(InputError, match=r"contains a corpus with another turn_deg"):
        prepare_lit_points(other, STUDY, Silent(), 1)
