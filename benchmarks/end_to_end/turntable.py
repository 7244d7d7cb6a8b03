"""Photographs of a turntable with their camera matrices, as a stereo sequence with known motion.

    python -m benchmarks.end_to_end.turntable IMAGES MATRICES.mat -o SEQ

View k is the left image and view k + 1 the right one of a rig whose axes converge; the target spins by one
step of the turntable a second. SEQ/truth.csv has the poses of ``benchmarks.end_to_end.photographs``, which
judges a run. IMAGES holds the views in the order of their names; MATRICES is a MATLAB file with the camera
matrices ``P``, 3 x 4, as of the dinosaur of the Visual Geometry Group, Oxford.

Such matrices are known up to a scale and a projective map along the axis, which has two parameters, because
one camera saw a spin about one axis (Fitzgibbon, Cross, Zisserman, "Automatic 3D model construction for
turn-table sequences", SMILE 1998). They are chosen so that the pixels have right angles and the principal
point lies on the middle row. What they leave, the ratio of a pixel's sides, is printed: 1.067 is that of the
video standard of Europe. The unit of length is the distance of the camera from the middle of the axis, called
1 m. Rate and axis do not depend on any of these choices but through the rig.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares
from tyro.conf import Positional, arg

from benchmarks.command import command
from polhode.dataset_writer import image_path, write_camera_csv, write_png, write_sensor
from polhode.errors import InputError
from polhode.images import Grey
from polhode.lie import Array, inverse_pose, log_so3, make_pose
from polhode.rigid_fit import mean_rotation

STEP_NS = 1_000_000_000
FIRST_NS = 1_600_000_000_000_000_000
MIRROR = np.diag([1.0, 1.0, -1.0])
"""Along the axis of the turntable: the matrices do not tell on which side of the camera the target is."""


@dataclass(frozen=True)
class Turntable:
    """One camera before a turntable."""

    K: Array
    """(3, 3) [px], without skew"""
    X_CO: Array
    """(F, 4, 4) the object in the camera, in each view; z of O is the axis"""


def main(
    images: Positional[Annotated[Path, arg(help="Folder of the views.")]],
    matrices: Positional[Annotated[Path, arg(help="MATLAB file with P.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="SEQ", help="Folder of the sequence.")],
) -> None:
    """Write the sequence."""
    views = sorted(each for each in images.iterdir() if each.suffix in (".ppm", ".pgm", ".png"))
    P = np.array([np.asarray(each, dtype=np.float64) for each in loadmat(matrices)["P"].ravel()])
    if len(views) != len(P) or len(P) < 3:
        raise InputError(f"{images}: {len(views)} views for {len(P)} matrices; give all of them, 3 at least")
    pixels = [_read(each) for each in views]
    height, width = pixels[0].shape
    table = euclidean(P, 0.5 * (height - 1))
    # the rig: how the next view's camera stands to this one's, as if the object were at rest
    each_CC = table.X_CO[:-1] @ inverse_pose(table.X_CO[1:])
    X_CC = make_pose(mean_rotation(each_CC[:, :3, :3]), each_CC[:, :3, 3].mean(axis=0))
    stamps = FIRST_NS + STEP_NS * np.arange(len(P) - 1)
    for camera, X_BC in ((0, np.eye(4)), (1, X_CC)):
        folder = output / "mav0" / f"cam{camera}"
        write_sensor(folder, table.K, np.zeros(4), X_BC, width, height, 1.0)
        write_camera_csv(folder, stamps)
        for stamp, grey in zip(stamps, pixels[camera:], strict=False):
            write_png(image_path(folder, int(stamp)), grey)
    rows = np.column_stack([table.X_CO[:-1, :3, :3].reshape(-1, 9), table.X_CO[:-1, :3, 3]])
    text = "".join(
        f"{stamp},{','.join(f'{value:.17g}' for value in row)}\n"
        for stamp, row in zip(stamps, rows, strict=True)
    )
    (output / "truth.csv").write_text(text)
    step_deg = np.rad2deg(np.linalg.norm(log_so3(X_CC[:3, :3])))
    print(
        f"{len(stamps)} pairs: {output}; turned by {step_deg:.3f} deg, "
        f"baseline {np.linalg.norm(X_CC[:3, 3]):.4f} of the distance, "
        f"sides of a pixel {table.K[1, 1] / table.K[0, 0]:.4f}"
    )


def euclidean(P: Array, middle_row_px: float) -> Turntable:
    """The camera of matrices (F, 3, 4) that turn about one axis through the origin.

    Raises InputError if there is no such camera.
    """
    _, R0, _ = _parts(P[0])
    _, R1, _ = _parts(P[1])
    turn = log_so3(R0.T @ R1)
    axis = turn / np.linalg.norm(turn)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    along = make_pose(np.column_stack([side, np.cross(axis, side), axis]), np.zeros(3))

    def mapped(free: Array) -> Array:
        back = np.eye(4)
        back[2, 2], back[3, 2] = np.exp(-free[0]), -free[1] * np.exp(-free[0])
        return np.asarray(P @ along @ back)

    def off(free: Array) -> list[float]:
        K, _, _ = _parts(mapped(free)[0])
        return [K[0, 1] / K[0, 0], (K[1, 2] - middle_row_px) / K[0, 0]]

    found = least_squares(off, np.zeros(2))
    parts = [_parts(each) for each in mapped(found.x)]
    K = parts[0][0]
    if found.cost > 1e-12 or any(np.abs(each[0] - K).max() > 1e-6 * K[0, 0] for each in parts):
        raise InputError("the matrices are not those of one camera before a turntable")
    X_CO = np.array([make_pose(R, t) for _, R, t in parts])
    if X_CO[0, 2, 3] < 0.0:
        X_CO[:, :3, :3] = -X_CO[:, :3, :3] @ MIRROR
        X_CO[:, :3, 3] *= -1.0
    X_CO[:, :3, 3] /= np.linalg.norm(X_CO[0, :3, 3])
    K[0, 1] = 0.0
    return Turntable(K, X_CO)


def _read(path: Path) -> Grey:
    found = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if found is None:
        raise InputError(f"{path}: not an image; give the folder of the views")
    return np.asarray(found, dtype=np.uint8)


def _parts(P: Array) -> tuple[Array, Array, Array]:
    """K with a positive diagonal and 1 at its end, a rotation R, and t of P ~ K (R | t)."""
    K, R, centre = cv2.decomposeProjectionMatrix(P)[:3]
    signs = np.diag(np.sign(np.diag(K)))
    K, R = K @ signs, signs @ R
    R = R * np.sign(np.linalg.det(R))
    return K / K[2, 2], R, -R @ (centre[:3] / centre[3]).ravel()


if __name__ == "__main__":
    command(main)
