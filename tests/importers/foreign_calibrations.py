"""The calibration of a dataset in the formats of other programs, written from what they document."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from polhode.geometry.lie import Array, inverse_pose, log_so3, make_pose, wxyz_from_matrix
from tests.importers.recordings import Original, rectified

Written = list[Path]
IMU = make_pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.1, 0.2, -0.3]))
"""(4, 4) left camera in an IMU"""


def numbers(values: Array) -> str:
    return ", ".join(f"{value!r}" for value in np.ravel(values).tolist())


def matrix(values: Array) -> str:
    """As FileStorage writes it, whose key needs no blank before a list."""
    rows, columns = np.atleast_2d(values).shape
    text = f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
    return f"{text}   data:[ {numbers(values)} ]\n"


def size(data: Original) -> tuple[int, int]:
    return data.calibration.size_px(0)


def lens(data: Original, camera: int) -> list[float]:
    """k1, k2, p1, p2."""
    return [*data.dist[camera].tolist(), 0.0, 0.0, 0.0, 0.0][:4]


def named(data: Original, camera: int) -> dict[str, float]:
    K = data.K[camera]
    values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *lens(data, camera)]
    return dict(zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"), map(float, values), strict=True))


def opencv_xml(data: Original, area: Path) -> Written:
    def entry(name: str, values: Array) -> str:
        rows, columns = np.atleast_2d(values).shape
        text = " ".join(f"{value!r}" for value in np.ravel(values).tolist())
        head = f'<{name} type_id="opencv-matrix"><rows>{rows}</rows><cols>{columns}</cols><dt>d</dt>'
        return f"{head}\n<data>{text}</data></{name}>"

    parts = [entry(f"M{k + 1}", data.K[k]) + entry(f"D{k + 1}", np.array(lens(data, k))) for k in (0, 1)]
    parts += [entry("R", data.X_10[:3, :3]), entry("T", data.X_10[:3, 3])]
    path = area / "stereo.xml"
    path.write_text(f'<?xml version="1.0"?>\n<opencv_storage>\n{"".join(parts)}</opencv_storage>\n')
    return [path]


def opencv_loose(data: Original, area: Path) -> Written:
    text = "%YAML:1.0\n---\n"
    for k in (0, 1):
        text += f"K{k + 1}: {matrix(data.K[k])}D{k + 1}: {matrix(np.array(lens(data, k)))}"
    path = area / "loose.yml"
    path.write_text(f"{text}R: {matrix(data.X_10[:3, :3])}T: {matrix(data.X_10[:3, 3])}")
    return [path]


def arrays(data: Original, area: Path) -> Written:
    path = area / "stereo.npz"
    K1, K2 = data.K
    D1, D2 = lens(data, 0), lens(data, 1)
    R, T = data.X_10[:3, :3], data.X_10[:3, 3:]
    np.savez(path, K1=K1, D1=D1, K2=K2, D2=D2, R=R, T=T, map1=np.zeros((480, 640)))
    return [path]


def kalibr(data: Original, area: Path, poses: Callable[[int], str], head: str = "") -> Written:
    text = head
    for k in (0, 1):
        K = data.K[k]
        text += f"cam{k}:\n  camera_model: pinhole\n  distortion_model: radtan\n"
        text += f"  distortion_coeffs: [{numbers(np.array(lens(data, k)))}]\n"
        text += f"  intrinsics: [{numbers(np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]))}]\n"
        text += f"  resolution: [{size(data)[0]}, {size(data)[1]}]\n  rostopic: /cam{k}/image_raw\n{poses(k)}"
    path = area / "camchain-imucam.yaml"
    path.write_text(text)
    return [path]


def in_imu(data: Original, camera: int) -> Array:
    return IMU if camera == 0 else IMU @ data.X_01


def openvins(data: Original, area: Path) -> Written:
    return kalibr(data, area, lambda k: f"  T_imu_cam: {in_imu(data, k).tolist()}\n", "%YAML:1.0\n")


def two_in_imu(data: Original, area: Path) -> Written:
    return kalibr(data, area, lambda k: f"  T_cam_imu: {inverse_pose(in_imu(data, k)).tolist()}\n")


def orb_slam3(data: Original, area: Path) -> Written:
    text = '%YAML:1.0\n\nFile.version: "1.0"\nCamera.type: "PinHole"\n'
    for k in (0, 1):
        text += "".join(f"Camera{k + 1}.{name}: {value!r}\n" for name, value in named(data, k).items())
    text += f"Camera.width: {size(data)[0]}\nCamera.height: {size(data)[1]}\nCamera.fps: 20\n"
    path = area / "EuRoC.yaml"
    path.write_text(f"{text}Stereo.ThDepth: 60.0\nStereo.T_c1_c2: {matrix(data.X_01)}\n")
    return [path]


def orb_slam2(data: Original, area: Path) -> Written:
    """Settings for images that it rectifies itself."""
    R, P = rectified(data)
    text = "%YAML:1.0\nCamera.fx: 1.0\nCamera.bf: 1.0\n"
    for k, side in enumerate(("LEFT", "RIGHT")):
        text += f"{side}.height: {size(data)[1]}\n{side}.width: {size(data)[0]}\n"
        for name, values in (
            ("D", np.array([*lens(data, k), 0.0])),
            ("K", data.K[k]),
            ("R", R[k]),
            ("P", P[k]),
        ):
            text += f"{side}.{name}: {matrix(values)}"
    path = area / "EuRoC2.yaml"
    path.write_text(text)
    return [path]


def vins(data: Original, area: Path) -> Written:
    text = "%YAML:1.0\n\nimu: 1\nnum_of_cam: 2\n"
    for k in (0, 1):
        text += f'cam{k}_calib: "cam{k}_pinhole.yaml"\nbody_T_cam{k}: {matrix(in_imu(data, k))}'
        values = named(data, k)
        own = "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: camera\n"
        own += f"image_width: {size(data)[0]}\nimage_height: {size(data)[1]}\n"
        for part, names in (
            ("distortion", ("k1", "k2", "p1", "p2")),
            ("projection", ("fx", "fy", "cx", "cy")),
        ):
            own += f"{part}_parameters:\n" + "".join(f"   {name}: {values[name]!r}\n" for name in names)
        (area / f"cam{k}_pinhole.yaml").write_text(own)
    path = area / "euroc_stereo_imu_config.yaml"
    path.write_text(text)
    return [path]


def basalt(data: Original, area: Path) -> Written:
    poses, lenses = [], []
    for k in (0, 1):
        X = in_imu(data, k)
        w, x, y, z = wxyz_from_matrix(X[:3, :3]).tolist()
        p = X[:3, 3].tolist()
        poses.append(dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), (*p, x, y, z, w), strict=True)))
        values = named(data, k) | dict.fromkeys(("k3", "k4", "k5", "k6", "rpmax"), 0.0)
        lenses.append({"camera_type": "pinhole-radtan8", "intrinsics": values})
    content = {"T_imu_cam": poses, "intrinsics": lenses, "resolution": [list(size(data))] * 2}
    path = area / "calibration.json"
    path.write_text(json.dumps({"value0": content}))
    return [path]


def zed(data: Original, area: Path) -> Written:
    """The images are those of VGA."""
    text = ""
    for side, k in (("LEFT", 0), ("RIGHT", 1)):
        for name in ("HD", "VGA"):
            text += f"[{side}_CAM_{name}]\n" + "".join(f"{n}={v!r}\n" for n, v in named(data, k).items())
    turn, t_mm = log_so3(data.X_10[:3, :3]).tolist(), (-1e3 * data.X_10[:3, 3]).tolist()
    text += f"[STEREO]\nBaseline={t_mm[0]!r}\nTY={t_mm[1]!r}\nTZ={t_mm[2]!r}\n"
    text += "".join(f"{n}_VGA={v!r}\n{n}_HD={v!r}\n" for n, v in zip(("RX", "CV", "RZ"), turn, strict=True))
    path = area / "SN12345.conf"
    path.write_text(text)
    return [path]


def depthai(data: Original, area: Path) -> Written:
    """The right camera is stated in the colour one, and that one in the left one."""
    left_of_colour = make_pose(np.eye(3), np.array([0.0375, 0.0, 0.0]))
    """turns points of the left camera into the colour one"""
    colour_of_right = left_of_colour @ data.X_01

    def extrinsics(X: Array, to: int) -> dict[str, object]:
        shift = dict(zip("xyz", (100.0 * X[:3, 3]).tolist(), strict=True))
        return {"rotationMatrix": X[:3, :3].tolist(), "translation": shift, "toCameraSocket": to}

    def camera(k: int, where: dict[str, object]) -> dict[str, object]:
        return {
            "cameraType": 0, "distortionCoeff": [*lens(data, k), *[0.0] * 10], "extrinsics": where,
            "height": size(data)[1], "width": size(data)[0], "intrinsicMatrix": data.K[k].tolist(),
        }  # fmt: skip

    content = {
        "cameraData": [
            [0, camera(0, extrinsics(np.eye(4), -1))],
            [1, camera(0, extrinsics(left_of_colour, 0))],
            [2, camera(1, extrinsics(colour_of_right, 0))],
        ],
        "stereoRectificationData": {"leftCameraSocket": 1, "rightCameraSocket": 2},
    }
    path = area / "oak.json"
    path.write_text(json.dumps(content))
    return [path]


def colmap(data: Original, area: Path) -> Written:
    folder = area / "sparse"
    folder.mkdir()
    rows = "# Camera list with one line of data per camera:\n"
    for k in (0, 1):
        values = list(named(data, k).values())
        values[2], values[3] = values[2] + 0.5, values[3] + 0.5
        rows += f"{k + 1} OPENCV {size(data)[0]} {size(data)[1]} {' '.join(map(repr, values))}\n"
    (folder / "cameras.txt").write_text(rows)
    pose = np.concatenate([wxyz_from_matrix(data.X_10[:3, :3]), data.X_10[:3, 3]])
    words = " ".join(repr(value) for value in pose.tolist())
    (folder / "rigs.txt").write_text(f"# RIG_ID, NUM_SENSORS, ...\n1 2 CAMERA 1 CAMERA 2 1 {words}\n")
    return [folder]


def echoed(data: Original, area: Path) -> Written:
    """Two messages as ``ros2 topic echo`` prints them, one after the other."""
    R, P = rectified(data)
    paths = []
    for k, name in enumerate(("left", "right")):
        text = f"header:\n  stamp:\n    sec: 1\n    nanosec: 5\n  frame_id: {name}\n"
        text += f"height: {size(data)[1]}\nwidth: {size(data)[0]}\ndistortion_model: plumb_bob\n"
        for key, values in (
            ("d", np.array([*lens(data, k), 0.0])),
            ("k", data.K[k]),
            ("r", R[k]),
            ("p", P[k]),
        ):
            text += f"{key}:\n" + "".join(f"- {value!r}\n" for value in np.ravel(values).tolist())
        path = area / f"{name}_echo.yaml"
        path.write_text(f"{text}binning_x: 0\n---\n{text}---\n")
        paths.append(path)
    return paths


def renderer(data: Original, area: Path) -> Written:
    """Plain lists, as the page on formats shows them for Blender and Unreal."""
    text = "".join(f"K{k + 1}: {data.K[k].ravel().tolist()}\nD{k + 1}: {lens(data, k)}\n" for k in (0, 1))
    path = area / "stereo.yml"
    path.write_text(f"{text}R: {data.X_10[:3, :3].ravel().tolist()}\nT: {data.X_10[:3, 3].tolist()}\n")
    return [path]


PROGRAMS: dict[str, Callable[[Original, Path], Written]] = {
    "OpenCV, XML": opencv_xml,
    "OpenCV, K1 and lists without a blank": opencv_loose,
    "NumPy": arrays,
    "a renderer": renderer,
    "OpenVINS": openvins,
    "Kalibr, both cameras in the IMU": two_in_imu,
    "ORB-SLAM3": orb_slam3,
    "ORB-SLAM2": orb_slam2,
    "VINS-Fusion": vins,
    "Basalt": basalt,
    "ZED": zed,
    "OAK": depthai,
    "COLMAP": colmap,
    "ros2 topic echo": echoed,
}
