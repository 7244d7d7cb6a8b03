"""What the page's slider moves over: moments of the run, with a picture, a view of the body and a rate."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from polhode.lie import Array, inverse_pose
from polhode.pipeline.report.film import FilmFrame
from polhode.pipeline.run_directory.stored_run import StoredRun

MAX_STOPS = 600
"""Of a long run, evenly spread frames."""


def timeline(content: StoredRun, film: Sequence[FilmFrame]) -> dict[str, Any] | None:
    """Stops of the slider, as plain data; None without an estimate of at least two frames.

    time [s] since the first frame and frame number of each stop; picture: index of the nearest in time in
    ``film``; rate: angular velocity along P [deg/s]; eye and up: direction from the body to the left camera
    and direction that is up in its image, unit vectors in G (absent without measurements).
    """
    if content.motion is None or len(content.motion.trajectory.time_s) < 2:
        return None
    path = content.motion.trajectory
    count = len(path.time_s)
    stops = np.unique(np.linspace(0, count - 1, min(count, MAX_STOPS)).round().astype(int))
    out: dict[str, Any] = {
        "time": _rounded(path.time_s[stops], 3),
        "frame": stops.tolist(),
        "frames": count,
        "rate": _rounded(np.rad2deg(path.w_P[stops]), 3),
    }
    shown = np.array([each.frame for each in film if each.frame < count], dtype=np.int64)
    if len(shown):
        out["picture"] = np.abs(path.time_s[stops][:, None] - path.time_s[shown]).argmin(axis=1).tolist()
    views = camera_views(content)
    if views is not None:
        out["eye"], out["up"] = (_rounded(each[stops], 4) for each in views)
    return out


def camera_views(content: StoredRun) -> tuple[Array, Array] | None:
    """Directions (F, 3) in G: from the centre of mass to the left camera, and up in its image."""
    if content.motion is None or content.tracks is None:
        return None
    X_GR = inverse_pose(content.motion.X_NG) @ content.tracks.X_NR
    away = X_GR[:, :3, 3] - content.motion.com_G
    away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    # Rows of an image count downwards.
    return away, -X_GR[:, :3, 1]


def _rounded(values: Array, places: int) -> list[Any]:
    rounded: list[Any] = np.round(values, places).tolist()
    return rounded
