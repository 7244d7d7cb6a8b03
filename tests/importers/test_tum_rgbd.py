"""Folders of TUM RGB-D, images with depth, and datasets with ranges: noise, calibration, poses."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.geometry.lie import exp_so3
from polhode.importers.calibrations.read_rig import read_camera
from polhode.importers.import_sequence import import_sequence
from polhode.importers.options import Crop, ImportOptions
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import write_sensor
from polhode.records.range_images import RangeModel
from polhode.runtime.progress import Silent
from tests.importers.imports import imported, refused

COUNT, WIDTH, HEIGHT = 6, 64, 48
TIMES_S = [1305031102.175304 + 0.1 * k for k in range(COUNT)]
K = np.array([[52.5, 0.0, 31.9], [0.0, 52.5, 23.5], [0.0, 0.0, 1.0]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Six frames with colour, depth and poses, as the benchmark publishes them; and a calibration beside."""
    rng, base = np.random.default_rng(3), tmp_path / "freiburg"
    rows: dict[str, list[str]] = {"rgb": ["# timestamp filename"], "depth": ["# timestamp filename"]}
    poses = ["# ground truth trajectory", "# timestamp tx ty tz qx qy qz qw"]
    for k, time_s in enumerate(TIMES_S):
        colour = rng.integers(0, 30, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        colour[12:36, 20:44] = rng.integers(60, 250, (24, 24, 3))
        depth = np.zeros((HEIGHT, WIDTH), dtype=np.uint16)
        depth[12:36, 20:44] = np.round((1.2 + rng.normal(0.0, 0.002, (24, 24))) * 5000.0)
        for name, pixels, late_s in (("rgb", colour, 0.0), ("depth", depth, 0.0004)):
            stamp = f"{time_s + late_s:.6f}"
            file = base / name / f"{stamp}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(pixels).save(file)
            rows[name].append(f"{stamp} {name}/{stamp}.png")
        half = 0.05 * k
        poses.append(f"{time_s:.6f} {0.1 * k:.4f} 0.2 0.3 0.0 {np.sin(half):.6f} 0.0 {np.cos(half):.6f}")
    for name, lines in rows.items():
        (base / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (base / "groundtruth.txt").write_text("\n".join(poses) + "\n")
    write_sensor(tmp_path / "rig" / "cam0", K, np.zeros(4), np.eye(4), (WIDTH, HEIGHT), rate_hz=10.0)
    return base


def rig_of(folder: Path) -> dict[str, Any]:
    return {"calibration": (folder.parent / "rig",)}


def test_colour_depth_and_poses_become_a_dataset_with_ranges(folder: Path, tmp_path: Path) -> None:
    done = imported([folder], tmp_path / "S", **rig_of(folder))
    assert (done.pairs, done.kind) == (COUNT, "images with ranges")
    assert done.notes[0].startswith(
        "ranges: 0.0002 m per unit, standard deviation 0.5 mm and 1.425 mm at 1 m"
    )
    sequence = open_sequence(tmp_path / "S")
    assert sequence.has_ranges and len(sequence) == COUNT
    model = sequence.range_model
    assert model is not None and (model.scale_m, model.along_ray) == (0.0002, False)
    assert model.sigma_at(np.array(2.0)) == pytest.approx(np.hypot(0.5e-3, 4 * 1.425e-3))
    with Image.open(next((folder / "depth").iterdir())) as image:
        stored = np.asarray(image)
    found = sequence.read_range(0)
    assert np.isfinite(found).sum() == (stored > 0).sum() == 24 * 24
    assert np.nanmedian(found) == pytest.approx(1.2, abs=1e-3)
    np.testing.assert_array_equal(sequence.calibration.K0, K)
    assert sequence.timestamps_ns[0] == 1305031102175304000
    assert sequence.inspector_moves
    step = sequence.X_NC[0, :3, :3].T @ sequence.X_NC[1, :3, :3]
    np.testing.assert_allclose(step, exp_so3([0.0, 0.1, 0.0]), atol=1e-5)
    np.testing.assert_allclose(sequence.X_NC[1, :3, 3], [0.1, 0.2, 0.3], atol=1e-6)


ONE_CAMERA = {
    "OpenCV": (
        "%YAML:1.0\n---\nimage_width: 64\nimage_height: 48\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [52.5, 0., 31.9, 0., 52.5, 23.5, 0., 0., 1.]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
        "   data: [0.1, -0.2, 0., 0., 0.]\n"
    ),
    "ROS": (
        "image_width: 64\nimage_height: 48\ncamera_name: rgb\n"
        "camera_matrix: {rows: 3, cols: 3, data: [52.5, 0, 31.9, 0, 52.5, 23.5, 0, 0, 1]}\n"
        "distortion_model: plumb_bob\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0, 0, 0]}\n"
        "rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
        "projection_matrix: {rows: 3, cols: 4, data: [52.5, 0, 31.9, 0, 0, 52.5, 23.5, 0, 0, 0, 1, 0]}\n"
    ),
    "Kalibr": (
        "cam0:\n  camera_model: pinhole\n  intrinsics: [52.5, 52.5, 31.9, 23.5]\n"
        "  distortion_model: radtan\n  distortion_coeffs: [0.1, -0.2, 0.0, 0.0]\n  resolution: [64, 48]\n"
    ),
}


def test_one_camera_is_calibrated_in_any_format(tmp_path: Path) -> None:
    for name, text in ONE_CAMERA.items():
        camera = tmp_path / f"{name}.yaml"
        camera.write_text(text)
        found = read_camera([camera])
        assert (found.intrinsics, found.size_px) == ((52.5, 52.5, 31.9, 23.5), (WIDTH, HEIGHT))
        assert found.distortion == (0.1, -0.2, 0.0, 0.0)


def test_a_part_of_a_dataset_with_ranges_is_imported_and_replaced(folder: Path, tmp_path: Path) -> None:
    imported([folder], tmp_path / "S", **rig_of(folder))
    imported([tmp_path / "S"], tmp_path / "part", every=2, crop=Crop(10, 6, 40, 36))
    whole, part = open_sequence(tmp_path / "S"), open_sequence(tmp_path / "part")
    assert part.has_ranges and part.range_model == whole.range_model
    assert part.timestamps_ns.tolist() == whole.timestamps_ns.tolist()[::2]
    np.testing.assert_array_equal(part.read_range(1), whole.read_range(2)[6:42, 10:50])
    np.testing.assert_array_equal(part.calibration.K0[:2, 2], K[:2, 2] - [10.0, 6.0])
    np.testing.assert_allclose(part.X_NC, whole.X_NC[::2], atol=1e-12)
    # an import of ours is replaced and nothing else
    options = ImportOptions(**rig_of(folder))
    assert import_sequence([folder], tmp_path / "S", options, Silent(), overwrite=True).pairs == COUNT
    (tmp_path / "S" / "mav0" / "range0" / "note.txt").write_text("mine")
    assert "is no dataset that polhode import made" in refused([folder], tmp_path / "S", **rig_of(folder))


def test_two_folders_are_images_and_depth_where_the_unit_of_depth_is_given(
    folder: Path, small_sequence: Path, tmp_path: Path
) -> None:
    both, out = [folder / "rgb", folder / "depth"], tmp_path / "S"
    done = imported(both, out, **rig_of(folder), range_scale_m=0.0002, range_sigma_m=0.002)
    assert (done.pairs, done.kind) == (COUNT, "images with ranges")
    sequence = open_sequence(out)
    assert sequence.range_model == RangeModel(0.0002, 0.002, 0.0)
    assert np.nanmedian(sequence.read_range(0)) == pytest.approx(1.2, abs=1e-3)
    assert not (out / "mav0" / "cam1").exists()
    # scale and noise of another sensor can be given for TUM RGB-D too, and poses left out
    options = {"range_scale_m": 0.001, "range_sigma_m": 0.004, "range_growth_per_m": 0.0, "poses": "none"}
    imported([folder], tmp_path / "other", **rig_of(folder), **options)
    sequence = open_sequence(tmp_path / "other")
    assert not sequence.inspector_moves and sequence.range_model == RangeModel(0.001, 0.004, 0.0)
    assert np.nanmedian(sequence.read_range(2)) == pytest.approx(6.0, abs=0.01)
    for half in ({"range_scale_m": 0.001}, {"range_sigma_m": 0.001}, {"range_growth_per_m": 0.0}):
        line = refused(both, tmp_path / "half", **rig_of(folder), **half)
        assert "--range-scale-m and --range-sigma-m: give both" in line
    line = refused([small_sequence], tmp_path / "stereo", range_scale_m=0.001)
    assert "are for two folders (images, depth), bags with depth" in line
    for path in (folder / "depth").iterdir():
        Image.fromarray(np.full((HEIGHT, WIDTH), 1.2, np.float32)).save(path.with_suffix(".tiff"))
        path.unlink()
    line = refused(both, tmp_path / "metres", **rig_of(folder), range_scale_m=0.001, range_sigma_m=0.002)
    assert "floating-point values, whose scale is unknown" in line


BAD: tuple[tuple[str, Callable[[str], str], str], ...] = (
    ("depth", lambda t: t.replace(" depth/", "#"), "depth.txt line"),
    ("rgb", lambda t: t.replace(" rgb/", " ../rgb/"), "leads out of"),
    ("depth", lambda t: "# timestamp filename\n", "depth.txt is empty"),
    ("rgb", lambda t: "\n".join(reversed(t.splitlines())), "does not come after"),
    ("groundtruth", lambda t: t.replace(" 0.2 0.3", " 0.2"), "give 8 finite"),
    ("groundtruth", lambda t: t.replace(" 0.2 0.3 0.0 ", " 0.2 0.3 1.0 "), "not of unit length"),
    ("depth", lambda t: t.replace("13050", "14050"), "have no time in common: the depth images begin"),
)
"""Table, what is done to it, what is said"""


def test_bad_tables_images_and_calibrations_are_refused_in_a_line(folder: Path, tmp_path: Path) -> None:
    for table, change, words in BAD:
        path = folder / f"{table}.txt"
        text = path.read_text()
        path.write_text(change(text))
        assert words in refused([folder], tmp_path / "S", **rig_of(folder)), words
        path.write_text(text)
    for pixels, words in (
        (np.full((HEIGHT, WIDTH), 90, np.uint8), "where 16-bit grey is needed"),
        (np.full((24, 32), 900, np.uint16), "calibrated for images of 64x48 px, but they have 32x24"),
    ):
        for path in (folder / "depth").iterdir():
            Image.fromarray(pixels).save(path)
        assert words in refused([folder], tmp_path / "S", **rig_of(folder))
    line = refused([folder], tmp_path / "S")
    assert "no calibration in it; give --calibration: a file of OpenCV" in line
    twice = refused([folder], tmp_path / "S", calibration=(folder, folder))
    assert "2 were given for one camera" in twice
    shutil.rmtree(folder.parent / "rig")
    assert "rig" in refused([folder], tmp_path / "S", **rig_of(folder))
