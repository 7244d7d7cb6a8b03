"""How the views are arranged: 3D and images on the left, polhode and plots on the right."""

from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb

from polhode.geometry.lie import Array, transform_points
from polhode.report.polhode_and_inertia_figures import look_at

PATHS = ("N/trajectory", "N/camera_path", "P/trace")
"""Logged piece by piece: all pieces up to now are shown"""
PLOTS = (
    (
        ("Angular velocity [deg/s]", "plots/w_P_deg_s"),
        ("Sigma of the attitude [deg]", "plots/sigma_theta_deg"),
    ),
    (("Centre of mass [m]", "plots/r_N_m"), ("Velocity [m/s]", "plots/v_N_m_s")),
    (
        ("Inertia ratios", "plots/k"),
        ("Residuals, RMS [px]", "plots/residual_rms_px"),
        ("Observations", "plots/observations"),
    ),
)
"""Plots that share a place, as (title, entity)"""


BESIDE = np.array([0.75, -0.55, -0.25])
"""Place of the eye in the first left camera, over the distance of the target."""
POLHODE_DISTANCE = 2.6
"""Of the eye from the centre of the polhode, over the rate."""


@dataclass(frozen=True)
class Eyes:
    """From where the 3D views are seen at first; None: from where Rerun chooses."""

    scene: rrb.EyeControls3D
    polhode: rrb.EyeControls3D | None = None


def beside_camera(X_NL: Array, distance_m: float) -> rrb.EyeControls3D:
    """An eye that sees the left camera (4, 4) and what is at this distance before it."""
    position, between = (transform_points(X_NL, distance_m * p) for p in (BESIDE, np.array([0.0, 0.0, 0.6])))
    return rrb.EyeControls3D(position=position, look_target=between, eye_up=-X_NL[:3, 1])


def before_polhode(w_P: Array) -> rrb.EyeControls3D:
    """An eye before the middle of the path (n, 3) [rad/s]."""
    rate_deg = float(np.rad2deg(np.linalg.norm(w_P, axis=1).max()))
    direction = look_at(w_P)
    position = POLHODE_DISTANCE * rate_deg * direction / np.linalg.norm(direction)
    up = np.eye(3)[int(np.argmin(np.abs(direction)))]
    return rrb.EyeControls3D(position=position, look_target=[0.0, 0.0, 0.0], eye_up=up)


def arrangement(
    eyes: Eyes, has_motion: bool, landmarks_add_up: bool, has_right: bool = True
) -> rrb.Blueprint:
    """The blueprint of a recording.

    has_motion: False for a bare sequence, which has cameras only; landmarks_add_up: each frame
    logs those that it is the first to observe, not all of them; has_right: whether there are right images.
    """
    images = [
        rrb.Spatial2DView(name=f"{side.capitalize()} image", origin=f"N/camera/{side}")
        for side in ("left", "right")[: 1 + has_right]
    ]
    paths = [*PATHS, *(["N/target/landmarks"] if landmarks_add_up else [])]
    scene = rrb.Spatial3DView(
        name="Target and camera (N)",
        origin="N",
        contents=["+ $origin/**", "- $origin/camera/left/features", "- $origin/camera/left/tracks"],
        overrides={path: [_up_to_now()] for path in paths if path.startswith("N/")},
        line_grid=False,
        eye_controls=eyes.scene,
    )
    left = rrb.Vertical(scene, rrb.Horizontal(*images), row_shares=[3, 2])
    time = rrb.TimePanel(timeline="time", state="collapsed")
    if not has_motion:
        return rrb.Blueprint(left, time, collapse_panels=True)
    polhode = rrb.Spatial3DView(
        name="Polhode [deg/s] (P)",
        origin="P",
        overrides={"P/trace": [_up_to_now()]},
        line_grid=False,
        eye_controls=eyes.polhode,
    )
    plots = [
        rrb.Tabs(*(rrb.TimeSeriesView(name=title, origin=entity) for title, entity in place))
        for place in PLOTS
    ]
    right = rrb.Vertical(polhode, *plots, row_shares=[4, 3, 3, 3])
    return rrb.Blueprint(rrb.Horizontal(left, right, column_shares=[3, 2]), time, collapse_panels=True)


def _up_to_now() -> rrb.VisibleTimeRanges:
    ends = {"start": rrb.TimeRangeBoundary.infinite(), "end": rrb.TimeRangeBoundary.cursor_relative()}
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange(name, **ends) for name in ("frame", "time")])
