"""Calibrations of random rendered rigs: errors of every parameter against their standard deviations.

    python -m lab.calibration.random_rigs [--rigs 50] [--workers 2] [--short] [--record DIR]

Each rig has lenses, a pose of the right camera and 20 poses of a board that are drawn at random. One in four
has cameras of two resolutions; half have a chessboard, a quarter a ChArUco board, a quarter AprilTags. Images
are rendered through the true lenses, with blur and noise in 8 bits, and calibrated as the command does. NEES
is the squared error of all parameters of lenses and pose by their covariance, with as many degrees of freedom
as there are parameters. Of single parameters 95 % should be within two standard deviations.
"""

from typing import Annotated

import numpy as np
from scipy.stats import chi2
from tyro.conf import arg

from lab.command import RECORDS, Record, Short, Workers, command
from lab.presentation import markdown_table
from lab.record import Case, complete
from polhode.calibration.adjustment import RigState
from polhode.calibration.boards import Board, make_board
from polhode.calibration.calibrate import CalibratedRig, calibrate
from polhode.calibration.image_pairs import SIDES, BoardImage, ImagePairs
from polhode.calibration.lenses import Lens, Model, project
from polhode.calibration.result import result_of
from polhode.geometry.lie import Array, exp_so3, log_so3, make_pose, transform_points
from polhode.runtime.progress import Silent
from tests.calibration.board_images import BoardCamera, printed

VIEWS = 20
SIZES = {"chessboard": ((480, 360), (400, 320)), "charuco": ((720, 540), (600, 480))}
"""Width and height [px] of most images, and of a right camera with other ones. Markers need more pixels."""
MODELS: tuple[Model, ...] = ("brown5", "fisheye", "brown8", "fisheye")
BOARDS = (
    ("chessboard", "9x6", 0.03),
    ("chessboard", "8x5", 0.033),
    ("charuco", "7x5", 0.045),
    ("aprilgrid", "4x3", 0.06),
)


def random_lens(model: Model, size_px: tuple[int, int], rng: np.random.Generator) -> Lens:
    """A lens with its principal point within 4 % of the middle."""
    width = size_px[0]
    share = rng.uniform(0.42, 0.5) if model == "fisheye" else rng.uniform(0.75, 1.1)
    focal = share * width * np.array([1.0, rng.uniform(0.995, 1.005)])
    centre = 0.5 * (np.array(size_px) - 1.0) + rng.uniform(-0.04, 0.04, 2) * width
    if model == "fisheye":
        k = rng.uniform([-0.03, -0.01, -0.003, -0.001], [0.05, 0.01, 0.003, 0.001])
    else:
        k1 = rng.uniform(-0.32, 0.05)
        k = np.array([k1, 0.35 * k1**2 + rng.uniform(-0.02, 0.02), *rng.uniform(-0.001, 0.001, 2), 0.0])
        if model == "brown8":
            # the same image by a denominator
            k4 = rng.uniform(0.1, 0.4)
            k = np.array([k[0] + k4, k[1] + k4 * k[0], k[2], k[3], 0.0, k4, rng.uniform(-0.02, 0.02), 0.0])
    return Lens(model, np.concatenate([focal, centre, k]))


def board_poses(
    board: Board,
    X_10: Array,
    lenses: tuple[Lens, Lens],
    sizes: tuple[tuple[int, int], ...],
    rng: np.random.Generator,
) -> Array:
    """(VIEWS, 4, 4) poses of boards that both images show whole: tilted, near and far, everywhere."""
    low, high = board.points.min(axis=0), board.points.max(axis=0)
    margin = board.square_m * (2.2 if board.pattern == "chessboard" else 1.2)
    corners = np.array(
        [
            [x, y, 0.0]
            for x in (low[0] - margin, high[0] + margin)
            for y in (low[1] - margin, high[1] + margin)
        ]
    )
    facing = np.diag([1.0, -1.0, -1.0]) if board.pattern == "aprilgrid" else np.eye(3)
    reach = 0.5 * float(np.linalg.norm(high - low))
    near = 1.5 if lenses[0].is_fisheye else 2.3
    poses: list[Array] = []
    while len(poses) < VIEWS:
        distance = reach * rng.uniform(near, 1.9 * near)
        side = distance * (1.0 if lenses[0].is_fisheye else 0.45)
        middle = np.array([*rng.uniform(-side, side, 2), distance]) - 0.5 * X_10[:3, 3] * [1.0, 0.0, 0.0]
        toward = middle / np.linalg.norm(middle)
        # the board faces the camera from where it is, then is tilted
        turn = exp_so3(np.cross([0.0, 0.0, 1.0], toward) * (0.8 if lenses[0].is_fisheye else 0.0))
        R = turn @ exp_so3(rng.uniform(-0.6, 0.6, 3)) @ facing
        X = make_pose(R, middle - R @ (0.5 * (low + high)))
        seen = [
            project(lens, transform_points(Y, corners)) for lens, Y in zip(lenses, (X, X_10 @ X), strict=True)
        ]
        if all(
            np.isfinite(uv).all() and (uv > 2.0).all() and (uv < np.array(size) - 3.0).all()
            for uv, size in zip(seen, sizes, strict=True)
        ):
            poses.append(X)
    return np.array(poses)


def measure(case: Case) -> Case:
    """Render and calibrate one rig."""
    seed = int(case["rig"])
    rng = np.random.default_rng([23, seed])
    model = MODELS[seed % len(MODELS)]
    pattern, size, square_m = BOARDS[(seed // 4) % len(BOARDS)]
    board = make_board(pattern, size, square_m)
    usual, other = SIZES["chessboard" if pattern == "chessboard" else "charuco"]
    sizes = (usual, other if seed % 4 == 3 else usual)
    lenses = (random_lens(model, sizes[0], rng), random_lens(model, sizes[1], rng))
    X_10 = make_pose(
        exp_so3(rng.uniform(-0.06, 0.06, 3)), [-rng.uniform(0.04, 0.1), *rng.uniform(-0.005, 0.005, 2)]
    )
    truth = RigState(lenses, board_poses(board, X_10, lenses, sizes, rng), X_10)
    blur, noise = rng.uniform(0.5, 1.0), rng.uniform(0.5, 3.0)
    cameras = [BoardCamera(lens, each) for lens, each in zip(lenses, sizes, strict=True)]
    picture = printed(board)
    images = []
    for pair, X in enumerate(truth.X_CB):
        for side, (camera, X_CB) in enumerate(zip(cameras, (X, X_10 @ X), strict=True)):
            images.append(BoardImage(side, pair, camera.picture(picture, X_CB, blur, noise, rng)))
    left, right = (tuple(f"{side} {k:02d}" for k in range(VIEWS)) for side in SIDES)
    rig = calibrate(ImagePairs((left, right), lambda: iter(images)), board, (model, model), Silent())
    return {"model": model, "pattern": pattern, "blur_px": blur, "noise": noise, **judged(rig, truth)}


def judged(rig: CalibratedRig, truth: RigState) -> Case:
    """Errors of a calibration against the truth."""
    state, result = rig.state, result_of(rig)
    turn = log_so3(truth.X_10[:3, :3].T @ state.X_10[:3, :3])
    off = np.concatenate(
        [
            *(a.values - b.values for a, b in zip(state.lenses, truth.lenses, strict=True)),
            turn,
            state.X_10[:3, 3] - truth.X_10[:3, 3],
        ]
    )
    covariance = rig.adjusted.covariance
    scaled = off / np.sqrt(np.diag(covariance))
    low, high = chi2.interval(0.95, len(off))
    nees = float(off @ np.linalg.solve(covariance, off))
    return {
        "parameters": len(off),
        "nees": nees,
        "inside": bool(low <= nees <= high),
        "sigmas": [round(value, 3) for value in scaled.tolist()],
        "corner_sigma_px": [each.corner_sigma_px for each in result.cameras],
        "epipolar_px": result.epipolar_rms_px,
        "rejected": [each.kind for each in result.rejected],
    }


def summary(lines: list[Case]) -> str:
    """A row for each lens model, and for each board."""
    rows = [
        _row(str(value), [line for line in lines if line[key] == value])
        for key in ("model", "pattern")
        for value in sorted({line[key] for line in lines})
    ]
    head = (
        " | rigs | NEES over its degrees of freedom | 95 % band of that mean | rigs inside their 95 % band | "
        "parameters within 2 sigma | largest error | corner's sigma | epipolar error | images left out"
    )
    return markdown_table(head, [*rows, _row("all", lines)])


def _row(name: str, lines: list[Case]) -> tuple[str, ...]:
    freedom = sum(line["parameters"] for line in lines)
    mean = sum(line["nees"] for line in lines) / freedom
    low, high = (value / freedom for value in chi2.interval(0.95, freedom))
    scaled = np.abs(np.concatenate([line["sigmas"] for line in lines]))
    return (
        name,
        str(len(lines)),
        f"{mean:.2f}",
        f"{low:.2f} to {high:.2f}",
        f"{sum(line['inside'] for line in lines)} of {len(lines)}",
        f"{100 * np.mean(scaled <= 2.0):.1f} %",
        f"{scaled.max():.1f} sigma",
        f"{np.median([line['corner_sigma_px'] for line in lines]):.3f} px",
        f"{np.median([line['epipolar_px'] for line in lines]):.3f} px",
        str(sum(len(line["rejected"]) for line in lines)),
    )


def main(
    rigs: Annotated[int, arg(help="So many of the random rigs.")] = 50,
    workers: Workers = 2,
    short: Short = False,
    record: Record = RECORDS / "random_rigs",
) -> None:
    """Measure what the record lacks, and print the table."""
    print(summary(complete(record, [{"rig": rig} for rig in range(1 if short else rigs)], measure, workers)))


if __name__ == "__main__":
    command(main)
