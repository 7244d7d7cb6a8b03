"""A chessboard seen through the whole camera calibrates back to the camera that saw it."""

from functools import cache

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points
from polhode.simulation.bodies.part import Body, Part, assemble, join
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, build_cameras, expose
from polhode.simulation.surface.materials import Material

COLUMNS, ROWS, SQUARE_M = 9, 6, 0.025
"""Inner corners, as the calibration counts them."""
RIG = config.Rig(
    width_px=320,
    height_px=240,
    focal_px=280.0,
    principal_offset_px=(4.0, -3.0),
    distortion=(-0.22, 0.06, 1.2e-3, -8e-4),
)
POSES, MARGIN_PX = 16, 8.0


@cache
def _board() -> Body:
    """Squares of two materials side by side, white around them; inner corners in the plane z = 0 of G."""
    sides: dict[bool, list[trimesh.Trimesh]] = {True: [], False: []}
    for i in range(-1, COLUMNS + 2):
        for j in range(-1, ROWS + 2):
            inside = 0 <= i <= COLUMNS and 0 <= j <= ROWS
            square = trimesh.creation.box([SQUARE_M, SQUARE_M, 0.004])
            square.apply_translation([(i - 0.5) * SQUARE_M, (j - 0.5) * SQUARE_M, 0.002])
            sides[inside and (i + j) % 2 == 0].append(square)
    paints = {True: Material(0.05, specular=0.0), False: Material(0.45, specular=0.0)}
    return assemble([Part(join(sides[dark]), paint) for dark, paint in paints.items()])


def _corners_G() -> Array:
    """(54, 3) [m], row by row."""
    j, i = np.mgrid[:ROWS, :COLUMNS]
    return SQUARE_M * np.stack([i.ravel(), j.ravel(), np.zeros(i.size)], axis=1)


def _poses(camera: Camera, rng: np.random.Generator) -> list[Array]:
    """Boards tilted by 10 to 50 degrees, turned any way, as near as all corners stay in the image."""
    middle_G = 0.5 * SQUARE_M * np.array([COLUMNS - 1, ROWS - 1, 0])
    size_px = np.array([camera.width_px, camera.height_px])
    poses: list[Array] = []
    while len(poses) < POSES:
        tilt, around, roll = rng.uniform([0.2, 0.0, 0.0], [0.9, 2 * np.pi, 2 * np.pi])
        R = exp_so3([tilt * np.cos(around), tilt * np.sin(around), 0.0]) @ exp_so3([0, 0, roll])
        at = rng.uniform([-0.05, -0.04, 0.18], [0.05, 0.04, 0.26])
        X_NG = make_pose(R, at - R @ middle_G)
        uv = camera.project(transform_points(X_NG, _corners_G()))
        if (uv > MARGIN_PX).all() and (uv < size_px - MARGIN_PX).all():
            poses.append(X_NG)
    return poses


def _found_corners(image: NDArray[np.uint8], true_px: Array) -> NDArray[np.float32] | None:
    """Corners (54, 2) as a user finds them: OpenCV's detector, refined; the truth tells the board's ends."""
    found, corners = cv2.findChessboardCorners(image, (COLUMNS, ROWS))
    if not found:
        return None
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    refined = np.asarray(cv2.cornerSubPix(image, start, (5, 5), (-1, -1), stop)).reshape(-1, 2)
    # The board looks the same from both ends.
    near = np.linalg.norm(refined[0] - true_px[0]) < np.linalg.norm(refined[-1] - true_px[0])
    return (refined if near else refined[::-1]).astype(np.float32)


def test_calibration_with_a_rendered_board_finds_the_camera() -> None:
    """Default lens, exposure and noise. The corners scatter by 0.04 px: pixels and samples."""
    camera, _ = build_cameras(RIG)
    light = config.Light(sun_direction_N=(0.0, -0.1, -1.0), earth=0.0, sun_diameter_deg=0.0)
    scene = config.Scene(light=light, render=config.Render(samples=16, bounces=0))
    renderer = Renderer(_board(), scene, 0)
    board, seen, errors = [], [], []
    for k, X_NG in enumerate(_poses(camera, np.random.default_rng(3))):
        level = renderer.picture(camera, np.eye(4), X_NG).level
        image = expose(level, scene.sensor, np.random.default_rng(k)).astype(np.uint8)
        true_px = camera.project(transform_points(X_NG, _corners_G()))
        corners = _found_corners(image, true_px)
        if corners is not None:
            board.append(_corners_G().astype(np.float32))
            seen.append(corners)
            errors.append(corners - true_px)
    assert len(seen) >= 12
    error = np.concatenate(errors)
    assert np.abs(np.median(error, axis=0)).max() < 0.01
    assert error.std(axis=0).max() < 0.06
    size = (camera.width_px, camera.height_px)
    _, K, dist, _, _ = cv2.calibrateCamera(board, seen, size, None, None, flags=cv2.CALIB_FIX_K3)
    assert np.abs(K - camera.K).max() < 0.1
    # Coefficients trade with each other; what they do to a pixel does not.
    rays = camera.pixel_directions
    there = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, dist)[0].reshape(-1, 2)
    assert np.abs(there - camera.project(rays)).max() < 0.3
    assert np.abs(there - camera.project(rays)).mean() < 0.05
    np.testing.assert_allclose(dist.ravel()[:4], camera.dist, atol=5e-3)
