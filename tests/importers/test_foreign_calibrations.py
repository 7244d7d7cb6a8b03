"""Calibrations of other programs are read with their numbers, or refused by their name."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.importers.calibrations.camera_info import CameraInfo, rig_of
from polhode.importers.calibrations.read_rig import read_rig
from polhode.runtime.errors import InputError
from tests.importers.foreign_calibrations import PROGRAMS, kalibr, zed
from tests.importers.recordings import Original, original

TURNED = make_pose(exp_so3([0.01, -0.13, 0.02]), [0.091, 0.0012, -0.003])


def converging(data: Original) -> Original:
    """A rig whose cameras turn towards each other, where mistaken conventions show."""
    return replace(data, calibration=replace(data.calibration, X_BC0=np.eye(4), X_BC1=TURNED))


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_rig_of_a_program_is_read(name: str, small_sequence: Path, tmp_path: Path) -> None:
    data = converging(original(small_sequence))
    paths = PROGRAMS[name](data, tmp_path)
    rig = read_rig(paths, lambda: (672, 376))
    X_01 = inverse_pose(rig.left.X_BC) @ rig.right.X_BC
    np.testing.assert_allclose(X_01, TURNED, rtol=0.0, atol=1e-9)
    for camera, (K, dist) in zip(rig.cameras, zip(data.K, data.dist, strict=True), strict=True):
        np.testing.assert_allclose(camera.intrinsics, [K[0, 0], K[1, 1], K[0, 2], K[1, 2]], rtol=1e-12)
        np.testing.assert_allclose(camera.distortion[:4], [*dist, 0.0, 0.0, 0.0, 0.0][:4], atol=1e-15)
        assert camera.size_px in (data.calibration.size_px(0), (672, 376), None)


def test_the_file_that_the_page_shows_for_a_renderer_is_read(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/formats.md").read_text()
    path = tmp_path / "stereo.yml"
    path.write_text(page.partition("```yaml\n")[2].partition("```")[0])
    rig = read_rig([path])
    assert rig.baseline_m == pytest.approx(0.12)
    # the horizontal field of view of 640 px
    assert 2.0 * np.rad2deg(np.arctan(320.0 / rig.left.intrinsics[0])) == pytest.approx(60.0, abs=1e-4)


def test_rectified_cameras_of_orb_slam_and_kitti_are_a_baseline_apart(tmp_path: Path) -> None:
    settings = tmp_path / "KITTI00-02.yaml"
    values = "Camera.fx: 718.856\nCamera.fy: 718.856\nCamera.cx: 607.1928\nCamera.cy: 185.2157\n"
    settings.write_text(f"%YAML:1.0\n{values}Camera.width: 1241\nCamera.height: 376\nCamera.bf: 386.1448\n")
    rig = read_rig([settings])
    assert rig.baseline_m == pytest.approx(386.1448 / 718.856) and rig.left.model == "none"
    settings.write_text(settings.read_text().replace("Camera.bf: 386.1448", "Stereo.b: 0.54"))
    assert read_rig([settings]).baseline_m == pytest.approx(0.54)
    # numbers of the odometry benchmark's sequence 00
    calib = tmp_path / "calib.txt"
    K = "7.18856e+02 0.0 6.071928e+02 {} 0.0 7.18856e+02 1.852157e+02 {} 0.0 0.0 1.0 {}"
    shifts = [(0.0, 0.0, 0.0), (-386.1448, 0.0, 0.0)]
    shifts += [(45.38225, -0.1130887, 0.003779761), (-337.2877, 2.369057, 0.004915215)]
    calib.write_text("".join(f"P{k}: {K.format(*t)}\n" for k, t in enumerate(shifts)))
    grey = read_rig([calib], lambda: (1241, 376))
    assert grey.baseline_m == pytest.approx(0.5371657, abs=1e-6) and grey.left.size_px == (1241, 376)
    colour = read_rig([calib], lambda: (1241, 376), (2, 3))
    assert colour.right.X_BC[0, 3] == pytest.approx(0.5327, abs=2e-3)


def test_a_lens_is_not_lost(small_sequence: Path, tmp_path: Path) -> None:
    data = converging(original(small_sequence))
    (path,) = PROGRAMS["a renderer"](data, tmp_path)
    plain = path.read_text()
    for flag in (
        "fisheye_model: 1",
        "camera_model: fisheye",
        "is_fisheye: true",
        "lens_model: KannalaBrandt",
    ):
        path.write_text(f"{plain}{flag}\n")
        assert read_rig([path]).left.model == "equidistant"
    path.write_text(f"{plain}xi1: [1.2]\n")
    assert "an omnidirectional model (xi)" in refusal([path])
    (settings,) = PROGRAMS["ORB-SLAM3"](data, tmp_path)
    text = settings.read_text()
    parallel = text[: text.index("Stereo.T_c1_c2")] + "Stereo.b: 0.12\n"
    settings.write_text(parallel)
    rig = read_rig([settings])
    assert rig.baseline_m == pytest.approx(0.12) and any(rig.left.distortion)
    settings.write_text(f"{parallel}RGBD.DepthMapFactor: 5000.0\n")
    assert "settings of ORB-SLAM for a camera with depth" in refusal([settings])
    for name in ("rig.npy", "rig.mat", "rig.pkl"):
        (tmp_path / name).write_bytes(b"\x93NUMPY")
        assert "which is not read; give a file of OpenCV" in refusal([tmp_path / name])
    (tmp_path / "ost.txt").write_text("# oST version 5.0 parameters\n\n[image]\n\nwidth\n640\n")
    assert "of no format that is read" in refusal([tmp_path / "ost.txt"])


def test_cameras_of_kitti_before_rectification(tmp_path: Path) -> None:
    path = tmp_path / "calib_cam_to_cam.txt"
    R, shift = np.array(exp_so3([0.01, 0.0, -0.02])), np.array([-0.537, 0.005, -0.012])
    rows = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for k, (turn, t) in enumerate(((np.eye(3), np.zeros(3)), (R, shift))):
        D, K = "-0.37 0.2 0.001 0.002 -0.07", "984.0 0.0 690.0 0.0 980.0 233.0 0.0 0.0 1.0"
        rows += [f"S_{k:02d}: 1.392e+03 5.12e+02", f"K_{k:02d}: {K}", f"D_{k:02d}: {D}"]
        for name, values in (("R", turn), ("T", t)):
            rows.append(f"{name}_{k:02d}: {' '.join(map(repr, np.ravel(values).tolist()))}")
        rows.append(f"P_rect_{k:02d}: 721.5 0.0 609.6 {-387.5 * k} 0.0 721.5 172.9 0.0 0.0 0.0 1.0 0.0")
    path.write_text("\n".join(rows))
    rectified, recorded = read_rig([path], lambda: (1242, 375)), read_rig([path], lambda: (1392, 512))
    assert rectified.baseline_m == pytest.approx(387.5 / 721.5)
    np.testing.assert_allclose(inverse_pose(recorded.right.X_BC), make_pose(R, shift), atol=1e-12)
    assert len(recorded.left.distortion) == 5


def info(P: Sequence[float] = (), R: float = 1.0) -> CameraInfo:
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    whole = np.zeros((3, 4))
    if P:
        whole[:, :3], whole[:2, 3] = K, P
    return CameraInfo("camera_info", 640, 480, "plumb_bob", (0.0,) * 5, K, R * np.eye(3), whole)


def test_what_drivers_state_of_the_baseline() -> None:
    negative, positive = rig_of([info((0, 0)), info((-35, 0))]), rig_of([info((0, 0)), info((35, 0))])
    np.testing.assert_array_equal(negative.right.X_BC, positive.right.X_BC)
    assert negative.baseline_m == pytest.approx(0.07) and not negative.remarks
    assert "Tx is positive in P, taken as the distance" in positive.remarks[0]
    X_01 = make_pose(np.eye(3), [0.07, 0.0, 0.0])
    # as a simulator leaves R and P, with the frames of tf
    bare = rig_of([info(R=0.0), info(R=0.0)], X_01=X_01)
    assert bare.baseline_m == pytest.approx(0.07) and bare.left.intrinsics == (500.0, 500.0, 320.0, 240.0)
    for infos, words in (
        ([info((-42.03, 0)), info((-42.03, 0))], "both cameras state the same fourth column of P, -42.03"),
        ([info((0, 0)), info((0, 0))], "the fourth column of P is 0"),
        ([info(R=0.0), info(R=0.0)], "P is 0, so the distance"),
        ([info((-35, 0)), info((0, 0))], "exchange left and right"),
    ):
        with pytest.raises(InputError, match=words):
            rig_of(infos)


def refusal(paths: Sequence[Path]) -> str:
    with pytest.raises(InputError) as caught:
        read_rig(paths, lambda: (640, 480))
    line = str(caught.value)
    assert "\n" not in line and len(line) < 600
    return line


OTHERS = {
    "camera.xml": ("<document version='1'><chunk/></document>", "Metashape"),
    "transforms.json": (json.dumps({"camera_angle_x": 0.7, "frames": []}), "nerfstudio or instant-ngp"),
    "sfm_data.json": (json.dumps({"sfm_data_version": "0.3", "views": []}), "OpenMVG"),
    "settings.json": (json.dumps({"SettingsVersion": 1.2, "SimMode": "ComputerVision"}), "AirSim"),
    "camera.json": (json.dumps({"cam_K": [1, 0, 0, 0, 1, 0, 0, 0, 1]}), "Blender or BlenderProc"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_format_that_is_not_read_is_named_with_those_that_are(name: str, tmp_path: Path) -> None:
    content, program = OTHERS[name]
    path = tmp_path / name
    path.write_text(content)
    line = refusal([path])
    assert f"{path}: a file of {program}" in line and "a camchain of Kalibr" in line


def test_models_and_parts_that_are_not_read_are_named(small_sequence: Path, tmp_path: Path) -> None:
    data = converging(original(small_sequence))
    chain = kalibr(data, tmp_path, lambda k: "")
    assert "cam1 lacks T_cn_cnm1" in refusal(chain)
    chain[0].write_text(chain[0].read_text().replace("pinhole", "omni"))
    assert "camera_model 'omni' is not supported" in refusal(chain)
    sizes = "of the ZED for images of 1280x720, 672x376 px, but they have 640x480"
    assert sizes in refusal(zed(data, tmp_path))
    for name, old, new, words in (
        ("Basalt", "pinhole-radtan8", "ds", "the camera_type 'ds' of camera 0 is not supported"),
        ("ORB-SLAM3", "Stereo.T_c1_c2", "Stereo.other", "settings of ORB-SLAM for one camera"),
        ("OAK", '"toCameraSocket": 0', '"toCameraSocket": 7', "nothing links the cameras 1 and 2"),
        ("VINS-Fusion", "cam1_calib", "cam7_calib", "lacks cam1_calib"),
    ):
        path = PROGRAMS[name](data, tmp_path)[0]
        path.write_text(path.read_text().replace(old, new))
        assert words in refusal([path])
    folder = PROGRAMS["COLMAP"](data, tmp_path)[0]
    (folder / "rigs.txt").unlink()
    assert "without rigs.txt, so the distance of the cameras is not stated" in refusal([folder])
    (folder / "cameras.txt").rename(folder / "cameras.bin")
    assert "colmap model_converter" in refusal([folder])
    entities = tmp_path / "entities.xml"
    hostile = '<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage><M1>&b;</M1></opencv_storage>'
    entities.write_text(f'<?xml version="1.0"?>{hostile}')
    assert "XML with a document type" in refusal([entities])
    (tmp_path / "none.npz").write_bytes(b"no archive")
    assert "not a readable archive of arrays" in refusal([tmp_path / "none.npz"])
