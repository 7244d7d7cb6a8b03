"""True disparities in the rectified pair, of a small rendered sequence on an odd rig; their cache."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from polhode.config.frontend_settings import Depth
from polhode.config.scene_settings import Light, Motion, Render, Rig, Scene, TargetBody
from polhode.frontend.rectification import make_rectifier
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.frame_renderer import products_path, read_products
from polhode.simulation.dataset.sequence import SCENE_FILE, simulate
from polhode.train.disparity.samples import build_samples, read_sample, true_disparities
from tests.conftest import MakeOnce


@pytest.fixture(scope="module")
def sequence(make_once: MakeOnce) -> StereoSequence:
    lens = (-0.1, 0.02, 1e-3, -5e-4)
    rig = Rig(width_px=160, height_px=120, focal_px=130.0, baseline_m=0.1, distortion=lens)
    scene = Scene(
        frames=3,
        truth_horizon_s=0.0,
        body=TargetBody(family="cubesat", size_m=0.25),
        motion=Motion(position_m=(0.04, 0.0, 0.6), attitude_deg=(30, 40, 10), spin_rpm=(2, 3, 1)),
        rig=rig.model_copy(update={"right_rotation_deg": (0.5, -3.0, 0.8)}),
        light=Light(sun_direction_N=(-0.6, -0.4, -0.6)),
        render=Render(samples=1, bounces=0, products=("depth", "shadow")),
    )
    return open_sequence(make_once("disparities", lambda folder: simulate(scene, 1, folder, Silent())))


def test_left_and_right_see_the_same_surface_at_the_same_disparity(sequence: StereoSequence) -> None:
    rectifier = make_rectifier(sequence.calibration)
    left, right = true_disparities(sequence, rectifier, 0)
    assert left.visible.sum() > 500
    v, u = np.nonzero(left.visible)
    d = left.disparity[v, u]
    there = right.disparity[v, np.round(u - d).astype(int)]
    assert np.isfinite(there).mean() > 0.95 and np.nanmedian(np.abs(there - d)) < 0.1
    # What the right camera sees lies as much on the left image's surface.
    v, u = np.nonzero(right.visible)
    back = left.disparity[v, np.round(u + right.disparity[v, u]).astype(int)]
    assert np.nanmedian(np.abs(back - right.disparity[v, u])) < 0.1
    # images agree at the true disparity and not beside it
    raw = sequence.read_pair(0)
    images = rectifier(raw.left, 0).astype(float), rectifier(raw.right, 1).astype(float)
    v, u = np.nonzero(left.visible & left.sunlit)
    d = left.disparity[v, u]
    differences = [
        np.mean(np.abs(images[0][v, u] - images[1][v, np.round(u - d + off).astype(int)]))
        for off in (-4, 0, 4)
    ]
    assert differences[1] < 0.6 * min(differences[0], differences[2])


def test_hidden_shadowed_and_sky_pixels_are_told_apart_and_need_the_truth(
    sequence: StereoSequence, tmp_path: Path
) -> None:
    rectifier = make_rectifier(sequence.calibration)
    left, _ = true_disparities(sequence, rectifier, 1)
    target = np.isfinite(left.disparity)
    assert not (left.visible & ~target).any() and not (left.sunlit & ~target).any()
    assert 0.5 < left.visible[target].mean() < 1.0
    assert 0.0 < left.sunlit[target].mean() < 1.0
    shutil.copytree(sequence.folder, tmp_path / "copy")
    path = products_path(tmp_path / "copy" / "mav0", 0, int(sequence.timestamps_ns[2]))
    depth = read_products(path).depth
    assert depth is not None
    np.savez(path, depth=depth)
    with pytest.raises(InputError, match="contains no depth or no shadow"):
        true_disparities(open_sequence(tmp_path / "copy"), rectifier, 2)


def test_a_scene_is_matched_again_only_for_other_images_or_settings(
    sequence: StereoSequence, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder, cache = tmp_path / "sequence", tmp_path / "cache"
    shutil.copytree(sequence.folder, folder)

    def times(seed: int = 3, every: int = 2) -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in build_samples(folder, cache, Depth(), seed, every)}

    made = times()
    assert len(made) > 1 and times() == made and caplog.text == ""
    assert times(seed=4) != made and "sequence.txt: of another scene or other settings" in caplog.text
    made = times()
    next(iter(made)).unlink()
    assert times() != made
    made = times()
    scene = folder / SCENE_FILE
    scene.write_text(scene.read_text() + "# another\n")
    assert times() != made
    # as an earlier version wrote it
    index = cache / "sequence.txt"
    index.write_text("\n".join(path.name for path in made))
    assert times().keys() == made.keys()
    index.write_text("notes of the user\n")
    with pytest.raises(InputError, match="is no list of samples, so it stays"):
        times()
    assert index.read_text() == "notes of the user\n"
    file = next(iter(made))
    file.write_bytes(file.read_bytes()[:-40])
    with pytest.raises(InputError, match=rf"{file}: .*; remove this file, and it is made again"):
        read_sample(file)
