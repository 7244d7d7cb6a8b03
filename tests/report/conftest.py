"""The runs without images of tests/pipeline, and one on disk with all that a report shows but masks."""

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.geometry.lie import make_pose
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.report import write_report
from polhode.run_directory.film import GAP_PX, GIF_SCALE, HEAD_PX, PANEL_PX
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from tests.pipeline.conftest import example, undetermined
from tests.pipeline.stored_run import stored

__all__ = ["example", "undetermined"]

UNKNOWN_UNTIL = 9
FILM_FRAMES = (0, 8, 16, 23)


def online_of(motion: MotionEstimate) -> OnlineEstimate:
    """As if the final estimate had been known causally, in another G; undetermined in the first frames."""
    F, mass = len(motion.r_N), motion.mass
    shift = make_pose(np.eye(3), [0.01, 0.02, -0.03])
    determined = np.arange(F)[:, None] >= np.array([UNKNOWN_UNTIL, UNKNOWN_UNTIL, 0, F])
    variance = np.where(determined, 1e-6, np.inf)
    cov_k, cov_com = np.zeros((F, 2, 2)), np.zeros((F, 3, 3))
    cov_k[:, [0, 1], [0, 1]] = variance[:, :2]
    cov_com[:, [0, 1, 2], [0, 1, 2]] = variance[:, 2:3]
    return OnlineEstimate(
        motion.timestamps_ns, motion.r_N, motion.v_N, motion.R_NP, motion.w_P, 4.0 * motion.covariance,
        motion.X_NG @ shift, np.tile([mass.k1, mass.k2], (F, 1)), cov_k,
        np.tile(mass.com_G - shift[:3, 3], (F, 1)), cov_com, np.tile(mass.R_GP, (F, 1, 1)),
        np.tile(np.diag([1e-6, np.inf, 1e-6]), (F, 1, 1)), determined, np.zeros(F, dtype=np.int64),
    )  # fmt: skip


def png(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def unpacked(array: dict[str, str]) -> np.ndarray:
    """An array of a figure."""
    return np.frombuffer(base64.b64decode(array["bdata"]), dtype="<" + array["dtype"])


@pytest.fixture(scope="session")
def run_folder(example: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a film in which a bright square moves to the right, one picture for each of ``FILM_FRAMES``."""
    folder = tmp_path_factory.mktemp("report") / "tumbler"
    (folder / "pictures").mkdir(parents=True)
    size = round(GIF_SCALE * (HEAD_PX + PANEL_PX + 54)), round(GIF_SCALE * (3 * PANEL_PX + 2 * GAP_PX))
    film = []
    for k in range(len(FILM_FRAMES)):
        picture = np.full(size, 30, dtype=np.uint8)
        picture[100:150, 20 + 60 * k : 70 + 60 * k] = 220
        film.append(Image.fromarray(picture).convert("P"))
    film[0].save(folder / "pictures" / "model.gif", save_all=True, append_images=film[1:], duration=100)
    rows = [f"{frame},0,1" for frame in FILM_FRAMES]
    (folder / "pictures" / "model.csv").write_text("\n".join(["frame,timestamp_ns,sunlit", *rows]) + "\n")
    stored(
        folder, example, example.surface, online_of(example.estimate),
        timing_s={"frontend": 12.0}, warnings=["the calibration was taken as right"],
        pictures={"frame 0: 150 inliers (blue)": png(np.full((90, 90), 70, dtype=np.uint8))},
    )  # fmt: skip
    (folder / "metrics.json").write_text('{"rmse_position_m": 1e-4, "mesh": {"chamfer_mm": 0.4}}')
    write_report(folder)
    return folder


@pytest.fixture(scope="session")
def content(run_folder: Path) -> StoredRun:
    return read_stored_run(run_folder, "tumbler")
