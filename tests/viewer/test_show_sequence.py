"""A bare sequence in Rerun: images, masks, rig and poses as recorded, and no truth."""

import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.geometry.lie import exp_so3, make_pose
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import mask_path, write_inspector, write_png
from polhode.runtime.progress import Silent
from polhode.viewer import recorder
from polhode.viewer.show_sequence import show_sequence
from polhode.viewer.target import ViewTarget
from tests.conftest import BASELINE_M, HEIGHT_PX, TIMESTAMPS_NS, WIDTH_PX
from tests.pipeline.conftest import REST_FRAMES
from tests.viewer.read_recording import rows_of, values_of


def recorded(sequence: Path, file: Path) -> Path:
    show_sequence(sequence, ViewTarget(file, window=False), Silent())
    return file


def _picture(blob: list[list[int]]) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(bytes(blob[0]))))


def test_images_rig_and_times(small_sequence: Path, tmp_path: Path) -> None:
    file, sequence = recorded(small_sequence, tmp_path / "s.rrd"), open_sequence(small_sequence)
    for side, name in enumerate(("left", "right")):
        blobs = values_of(file, f"/N/camera/{name}", "EncodedImage:blob")
        assert list(blobs) == list(range(len(TIMESTAMPS_NS)))
        pair = sequence.read_pair(2)
        error = _picture(blobs[2]).astype(float) - (pair.left, pair.right)[side]
        # single pixels of noise are what JPEG keeps least
        assert np.abs(error).mean() < 6.0
        camera = values_of(file, f"/N/camera/{name}", "Pinhole:image_from_camera")[-1][0]
        np.testing.assert_allclose(camera, [50, 0, 0, 0, 51, 0, 32, 24, 1])
    right = values_of(file, "/N/camera/right", "Transform3D:translation")[-1][0]
    np.testing.assert_allclose(right, [BASELINE_M, 0, 0], rtol=1e-6)
    times = [row["time"].total_seconds() for _, row in rows_of(file)["/N/camera"]]
    np.testing.assert_allclose(times, 1e-9 * (TIMESTAMPS_NS - TIMESTAMPS_NS[0]))


def test_outlines_of_masks_and_poses_of_the_inspector(small_sequence: Path, tmp_path: Path) -> None:
    mask = np.zeros((HEIGHT_PX, WIDTH_PX), dtype=np.uint8)
    mask[12:36, 20:44] = 255
    write_png(mask_path(small_sequence / "mav0", 0, int(TIMESTAMPS_NS[1])), mask)
    X_NB = np.stack([make_pose(exp_so3([0.0, 0.1 * k, 0.0]), [0.2 * k, 0.0, 0.0]) for k in range(6)])
    write_inspector(small_sequence / "mav0", TIMESTAMPS_NS, X_NB, 0.0, 0.0)
    file = recorded(small_sequence, tmp_path / "s.rrd")
    lines = values_of(file, "/N/camera/left/mask", "LineStrips2D:strips")
    assert [len(lines[k]) for k in range(6)] == [0, 1, 0, 0, 0, 0]
    corners = np.array(lines[1][0])
    assert corners.min(axis=0).tolist() == [20.5, 12.5] and corners.max(axis=0).tolist() == [43.5, 35.5]
    poses = values_of(file, "/N/camera", "Transform3D:translation")
    np.testing.assert_allclose([poses[k][0] for k in range(6)], X_NB[:, :3, 3], atol=1e-6)
    path = values_of(file, "/N/camera_path", "LineStrips3D:strips")
    np.testing.assert_allclose([line[0][1] for line in path.values()], X_NB[1:, :3, 3], atol=1e-6)


def test_truth_is_not_shown(at_rest: Path, tmp_path: Path) -> None:
    without = tmp_path / "without"
    shutil.copytree(at_rest, without)
    shutil.rmtree(without / "mav0" / "target0")
    first, second = recorded(at_rest, tmp_path / "a.rrd"), recorded(without, tmp_path / "b.rrd")
    assert repr(rows_of(first)) == repr(rows_of(second))
    assert len(values_of(first, "/N/camera/left", "EncodedImage:blob")) == REST_FRAMES


def test_large_images_are_shown_smaller_and_agree_with_their_camera(
    small_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "MAX_SIDE_PX", 40)
    file = recorded(small_sequence, tmp_path / "s.rrd")
    blob = values_of(file, "/N/camera/left", "EncodedImage:blob")[0]
    assert _picture(blob).shape == (HEIGHT_PX // 2, WIDTH_PX // 2)
    camera = values_of(file, "/N/camera/left", "Pinhole:image_from_camera")[-1][0]
    np.testing.assert_allclose(camera, [25, 0, 0, 0, 25.5, 0, 16, 12, 1])
