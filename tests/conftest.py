"""One thread for BLAS, as in the program; a tiny stereo sequence on disk, for tests to read and to damage."""

from polhode.threads import limit_threads

limit_threads(1)  # of what is imported below, and of NumPy, which a plugin of pytest has imported

# isort: split
from pathlib import Path

import numpy as np
import pytest

from polhode.dataset_writer import image_path, write_camera_csv, write_png, write_sensor

WIDTH_PX, HEIGHT_PX, BASELINE_M = 64, 48, 0.09
TIMESTAMPS_NS = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(6, dtype=np.int64)


@pytest.fixture
def small_sequence(tmp_path: Path) -> Path:
    """Six pairs of 64x48 px: a bright random patch before black sky with sensor noise."""
    rng = np.random.default_rng(7)
    folder = tmp_path / "sequence"
    for index in (0, 1):
        camera = folder / "mav0" / f"cam{index}"
        K = np.array([[50.0, 0.0, 31.5], [0.0, 51.0, 23.5], [0.0, 0.0, 1.0]])
        X_BC = np.eye(4)
        X_BC[0, 3] = BASELINE_M * index
        write_sensor(camera, K, np.array([-0.1, 0.01, 0.0, 0.0]), X_BC, WIDTH_PX, HEIGHT_PX, rate_hz=2.0)
        write_camera_csv(camera, TIMESTAMPS_NS)
        for stamp in TIMESTAMPS_NS:
            image = rng.normal(2.0, 1.0, (HEIGHT_PX, WIDTH_PX)).clip(0.0, 255.0)
            image[12:36, 20:44] = rng.integers(60, 250, (24, 24))
            write_png(image_path(camera, int(stamp)), image.astype(np.uint8))
    return folder
