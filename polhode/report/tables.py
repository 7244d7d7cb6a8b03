"""The text and tables of the report: the finding in a sentence, values with their standard deviations."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from polhode.geometry.lie import Array
from polhode.records.estimate import MotionEstimate
from polhode.records.metrics import ALIGNED, IN_INTERVAL, expected_range
from polhode.run_directory.stored_run import StoredRun
from polhode.run_directory.summary_schema import SAME_MINIMUM, Assumed, Intervals, Rotation, Summary
from polhode.run_directory.trajectory_file import Trajectory, standard_deviations

AXIS_NAMES = ("x (largest moment)", "y (middle moment)", "z (smallest moment)")


@dataclass(frozen=True)
class TableRow:
    """A line of a table."""

    name: str
    value: str
    unit: str = ""
    verdict: str = ""
    determined: bool = True


def with_sigma(value: float, sigma: float | None) -> str:
    """``0.0317 ± 0.0021``: the standard deviation with two digits, the value to the same digit."""
    if sigma is None or not np.isfinite(sigma):
        return f"{value:.3g}"
    if sigma <= 0.0:
        return f"{value:.6g} (exact)"
    places = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{places}f} ± {sigma:.{places}f}"


def finding(summary: Summary, trajectory: Trajectory | None) -> str:
    """What the run found, in a sentence or two."""
    inertia, known = summary.inertia, summary.identifiable
    if trajectory is None or inertia is None or known is None:
        reason = summary.warnings[0] if summary.warnings else "no estimate was reached"
        return f"No motion was found: {reason.rstrip('.')}."
    rate = np.linalg.norm(trajectory.w_P, axis=1)
    speed_mm_s = 1e3 * float(np.median(np.linalg.norm(trajectory.v_N, axis=1)))
    # The principal axis that is close to the angular velocity on average, if any.
    share = np.mean(np.abs(trajectory.w_P), axis=0) / max(float(np.mean(rate)), 1e-12)
    about = "about an axis that moves through the body"
    if share.max() > 0.9:
        about = f"about its principal axis {AXIS_NAMES[int(np.argmax(share))]}"
    rpm = float(np.median(rate)) * 30 / np.pi
    motion = f"The target rotates at {rpm:.2f} RPM {about} and drifts at {speed_mm_s:.1f} mm/s"
    ratios, unknown = [], []
    for k, name in enumerate(("k1", "k2")):
        interval = getattr(summary.intervals, name, None)
        if getattr(known, name):
            ratios.append(f"{name} = {with_sigma(getattr(inertia, name), _root(inertia.cov[k][k]))}")
        else:
            possible = "" if interval is None else f" ({_between('{:.2f}', interval)} is possible)"
            unknown.append(f"{name}{possible}")
    found = [f"its inertia ratios are {' and '.join(ratios)}"] if ratios else []
    found += [f"this motion does not determine {' and '.join(unknown)}"] if unknown else []
    return f"{motion}; {', '.join(found)}."


CheckKind = Literal["doubt", "holds", "information", "impossible"]
"""In the order of the panel; impossible: with these data it cannot be made."""


@dataclass(frozen=True)
class CheckRow:
    """A line of the panel of checks."""

    name: str
    value: str
    expected: str
    kind: CheckKind


def check_rows(summary: Summary) -> list[CheckRow]:
    """The checks of data and answer: those in doubt, those that hold, information, impossible ones."""
    rows = []
    for check in summary.checks:
        unit, limit = f" {check.unit}" if check.unit else "", check.limit
        value = "" if check.value is None else f"{_short(check.value)}{unit}"
        at = "at least" if check.at_least else "at most"
        expected = "information" if limit is None else f"{at} {_short(limit)}{unit}"
        kind: CheckKind = "doubt" if check.reason else "holds"
        if check.value is None or limit is None:
            kind = "impossible" if check.value is None else "information"
        rows.append(CheckRow(check.name, value, expected, kind))
    return sorted(rows, key=lambda row: get_args(CheckKind).index(row.kind))


def _short(value: float) -> str:
    """Three digits, without an exponent where a reader would not expect one."""
    return f"{value:.0f}" if float(value).is_integer() and abs(value) < 1e6 else f"{value:.3g}"


def inertia_rows(summary: Summary) -> list[TableRow]:
    """The mass properties, each with its standard deviation and whether the motion determines it."""
    inertia, known, parts = summary.inertia, summary.identifiable, summary.identifiable_components
    if inertia is None or known is None or parts is None or summary.com_G is None or summary.R_GP is None:
        return []
    detail, bounded = summary.identifiable_detail, summary.intervals or Intervals()
    rows = []
    for k, (name, ratio) in enumerate((("k1", "Jxx / Jyy"), ("k2", "Jyy / Jzz"))):
        interval = getattr(bounded, name)
        value = with_sigma(getattr(inertia, name), _root(inertia.cov[k][k]))
        value = value if interval is None else _between("{:.2f}", interval)
        rows.append(_row(f"{name} = ln({ratio})", value, "", getattr(known, name), detail.get(name, "")))
    moments = " : ".join(map(with_sigma, inertia.moments, inertia.sigma_moments))
    rows.append(_row("moments Jxx : Jyy : Jzz", moments, "middle one 1", known.k1 and known.k2))
    for k, axis in enumerate("xyz"):
        sigma = None if summary.cov_com_G is None else _root(summary.cov_com_G[k][k])
        value = with_sigma(1e3 * summary.com_G[k], None if sigma is None else 1e3 * sigma)
        if sigma is None and bounded.com_G is not None:
            value = _between("{:.1f}", [1e3 * end[k] for end in bounded.com_G])
        rows.append(_row(f"centre of mass, {axis} in G", value, "mm", sigma is not None))
    for k, axis in enumerate("xyz"):
        if not parts.com_P[k]:
            shift = None if bounded.com_shift_P is None else bounded.com_shift_P[k]
            value, unit = "no bound", ""
            if shift is not None:
                value, unit = _between("{:+.1f}", [1e3 * end for end in shift]), "mm from com_G"
            words = detail.get(f"com_{axis}", "")
            rows.append(_row(f"centre of mass, along the principal axis {axis}", value, unit, False, words))
    for k, axis in enumerate("xyz"):
        root = None if summary.cov_R_GP is None else _root(summary.cov_R_GP[k][k])
        value, unit = ("no bound", "") if root is None else (f"± {np.rad2deg(root):.2g}", "deg")
        words = detail.get(f"axes_{axis}", "")
        rows.append(_row(f"principal axes, rotated about {axis}", value, unit, parts.axes_P[k], words))
    return rows


def intervals_rest_on(summary: Summary) -> str:
    """A sentence about the intervals among the mass properties; empty: there are none."""
    if summary.intervals is None:
        return ""
    bounds = "; ".join(summary.intervals.bounds)
    return f"A range is where a quantity can lie that the motion does not determine: {bounds}."


def _between(form: str, ends: Sequence[float]) -> str:
    return f"from {form.format(ends[0])} to {form.format(ends[1])}"


def _row(name: str, value: str, unit: str, determined: bool, reason: str = "") -> TableRow:
    verdict = "determined" if determined else reason or "not determined by this motion"
    return TableRow(name, value, unit, verdict, determined)


def _root(variance: float | None) -> float | None:
    return None if variance is None else float(np.sqrt(max(variance, 0.0)))


def absolute_rows(summary: Summary) -> list[TableRow]:
    """Mass and inertia in kilograms, from known forces and torques; nothing when none are known."""
    inertia, detail = summary.inertia, summary.identifiable_detail
    if inertia is None:
        return []
    return [
        _row(name, with_sigma(value, sigma), unit, sigma is not None, detail.get(key, ""))
        for name, value, sigma, unit, key in (
            ("mass", inertia.mass_kg, inertia.sigma_mass_kg, "kg", "mass"),
            ("middle moment Jyy", inertia.scale_kg_m2, inertia.sigma_scale_kg_m2, "kg m²", "inertia_scale"),
        )
        if value is not None
    ]


def disturbance_rows(summary: Summary) -> list[TableRow]:
    """Effect of unknown forces and torques, two lines for each disturbance."""
    rows = []
    for impulse in summary.unknown_pushes:
        for name, change, sigma, scale, unit in (
            ("velocity, along N", impulse.delta_v_N, impulse.sigma_delta_v_N, 1e3, "mm/s"),
            ("rate, along P", impulse.delta_w_P, impulse.sigma_delta_w_P, float(np.rad2deg(1.0)), "deg/s"),
        ):
            scaled = [None if s is None else scale * s for s in sigma]
            parts = map(with_sigma, [scale * value for value in change], scaled)
            when = f"from {impulse.start_s:.1f} s to {impulse.end_s:.1f} s"
            rows.append(TableRow(f"{when}: change of {name}", ", ".join(parts), unit))
    return rows


def assumed_rows(assumed: Assumed | None) -> list[TableRow]:
    """Mass properties at uniform density, in kilograms; not estimated."""
    if assumed is None:
        return []
    moments = np.linalg.eigvalsh(np.array(assumed.inertia_kg_m2))[::-1]
    rows = [
        TableRow("volume", f"{1e3 * assumed.volume_m3:.4g}", "litres"),
        TableRow("density", f"{assumed.density_kg_m3:.4g}", "kg/m³"),
        TableRow("mass", f"{assumed.mass_kg:.4g}", "kg"),
        TableRow("moments Jxx, Jyy, Jzz", ", ".join(f"{moment:.4g}" for moment in moments), "kg m²"),
    ]
    ratios = (("k1", assumed.k1), ("k2", assumed.k2))
    rows += [TableRow(name, f"{value:.3f}") for name, value in ratios if value is not None]
    if assumed.com_G is not None:
        com_mm = ", ".join(f"{1e3 * part:.1f}" for part in assumed.com_G)
        rows.append(TableRow("centre of mass in G", com_mm, "mm"))
    return rows


def run_rows(content: StoredRun) -> list[TableRow]:
    """Size of the data, noise and solver."""
    summary = content.summary
    rows = [
        TableRow("frames", f"{summary.frames}"),
        TableRow("frames with measurements", f"{summary.frames_used}"),
        TableRow("duration of the data", f"{summary.duration_s:.1f}", "s"),
        TableRow("landmarks", f"{summary.landmarks}"),
        TableRow("observations", f"{summary.observations}"),
    ]
    rows += calibration_rows(summary)
    if (noise := summary.noise) is not None:
        rows += [
            TableRow(name, f"{value:.3f}", "px")
            for name, value in (
                ("noise of u, v", noise.pixel_sigma_px),
                ("noise of the disparity", noise.disparity_sigma_px),
                ("features slide with light and view", noise.drift_px),
            )
            if value is not None
        ]
        for name, psd, decades, unit in (
            ("disturbance acceleration", noise.accel_psd, noise.accel_psd_decades, "m/s² /√Hz"),
            ("disturbance torque / Jyy", noise.torque_psd, noise.torque_psd_decades, "rad/s² /√Hz"),
        ):
            # half of the power's decades are the amplitude's
            within = f", within a factor of {10.0 ** (0.5 * decades):.2g}" if decades else ""
            rows.append(TableRow(name, f"{np.sqrt(psd):.2g}{within}", unit))
    if (solver := summary.solver) is not None:
        ended = "converged" if solver.converged else f"stopped: {solver.message or 'not converged'}"
        rows.append(TableRow("solver", f"{solver.name}, {solver.iterations} iterations"))
        rows.append(TableRow("solver's end", ended, determined=solver.converged))
        if (ipopt := solver.ipopt) is not None:
            gradient = "" if ipopt.optimality is None else f", gradient {ipopt.optimality:.1g}"
            rows.append(TableRow("IPOPT", f"{ipopt.status}, {ipopt.iterations} iterations{gradient}"))
        rows.append(TableRow("cost", f"{solver.cost:.6g}"))
        if solver.reduced_chi2 is not None:
            rows.append(TableRow("reduced chi-squared", f"{solver.reduced_chi2:.3f}"))
        # Not a judgement: right and wrong runs do not differ by the excess cost of another start. An
        # ambiguity that matters is in the sigmas and the warnings.
        for name, cost in solver.runner_up.items():
            words = "did not converge" if cost is None else "ended in the same minimum"
            if cost is not None and cost > SAME_MINIMUM:
                words = f"ended in another minimum, whose cost is higher by {_short(cost)}"
            rows.append(TableRow(f"start from {name}", words))
    return rows


def motion_rows(content: StoredRun) -> list[TableRow]:
    """The motion in a few numbers, with the median standard deviation over the run, and the last rotation."""
    if content.motion is None:
        return []
    path = content.motion.trajectory
    rate_deg_s = np.rad2deg(np.median(np.linalg.norm(path.w_P, axis=1)))
    distance_m = np.median(np.linalg.norm(path.r_N, axis=1))
    rows = [
        TableRow("angular velocity, median", f"{rate_deg_s:.2f}", "deg/s"),
        TableRow("distance from the origin of N", f"{distance_m:.4f}", "m"),
    ]
    if len(path.time_s) > 1:
        turn_deg = rate_deg_s * float(np.median(np.diff(path.time_s)))
        name = "rotation between pairs (less than 180 is assumed, unless backend.max_rpm says more)"
        rows.append(TableRow(name, f"{turn_deg:.1f}", "deg"))
    for name, _, sigma, unit in _sigmas(path):
        worst = np.max(np.median(sigma, axis=0))
        found = (f"{worst:.2g}", unit) if np.isfinite(worst) else ("not determined",)
        rows.append(TableRow(f"σ {name}, worst axis", *found))
    return [*rows, *rotation_rows(content.summary.rotation)]


def rotation_rows(rotation: Rotation | None) -> list[TableRow]:
    """Angular momentum and spin axis at the last pair; nothing in a run of an earlier version."""
    if rotation is None:
        return []
    rows = []
    for name, found in (
        ("angular momentum, direction in N", rotation.momentum_N),
        ("spin axis at the last pair, in N", rotation.spin_N),
        ("spin axis at the last pair, in P", rotation.spin_P),
    ):
        spread = "not determined" if found.sigma_deg is None else f"± {found.sigma_deg:.2g} deg"
        unit = ", ".join(f"{part:.4f}" for part in found.unit)
        rows.append(TableRow(name, f"{unit}; {spread}", determined=found.sigma_deg is not None))
    for name, value, sigma, unit in (
        ("angular momentum over Jyy", rotation.momentum_rad_s, rotation.sigma_momentum_rad_s, "rad/s"),
        ("angular momentum", rotation.momentum_N_m_s, rotation.sigma_momentum_N_m_s, "N m s"),
    ):
        if value is not None:
            words = with_sigma(value, sigma) + ("; not determined" if sigma is None else "")
            rows.append(TableRow(name, words, unit, determined=sigma is not None))
    return rows


def _sigmas(path: Trajectory) -> tuple[tuple[str, str, Array, str], ...]:
    """(quantity, its axes, standard deviations (F, 3) as shown, unit) of the states."""
    return (
        ("position", "along N", 1e3 * path.sigma_r, "mm"),
        ("velocity", "along N", 1e3 * path.sigma_v, "mm/s"),
        ("attitude", "about P", np.rad2deg(path.sigma_theta), "deg"),
        ("angular velocity", "along P", np.rad2deg(path.sigma_w), "deg/s"),
    )


def sigma_rows(content: StoredRun) -> list[tuple[str, str, tuple[str, ...]]]:
    """(quantity, unit, standard deviations as text: along three axes, or one) of the states, averaged over
    all frames, then of the constants; nothing without an estimate."""
    motion, summary = content.motion, content.summary
    if motion is None or summary.inertia is None:
        return []

    def cells(sigma: Array) -> tuple[str, ...]:
        return tuple(f"{value:.3g}" if np.isfinite(value) else "no bound" for value in sigma)

    def roots(covariance: Any) -> Array:
        """Infinite where a variance is null in summary.json."""
        return standard_deviations(np.array(covariance, dtype=np.float64))

    com, axes, ratios = map(roots, (summary.cov_com_G, summary.cov_R_GP, summary.inertia.cov))
    return [
        *(
            (f"{name}, {along}, mean over the frames", unit, cells(sigma.mean(axis=0)))
            for name, along, sigma, unit in _sigmas(motion.trajectory)
        ),
        ("centre of mass, along G", "mm", cells(1e3 * com)),
        ("principal axes, about P", "deg", cells(np.rad2deg(axes))),
        *((f"inertia ratio k{k}", "", (cell,)) for k, cell in enumerate(cells(ratios), start=1)),
    ]


def calibration_rows(summary: Summary) -> list[TableRow]:
    """Whence the sigmas of the calibration are, and the parts of each sigma at the end of the run."""
    if (found := summary.calibration) is None:
        return [] if summary.noise is None else [TableRow("calibration's sigmas", "none: taken as exact")]
    rows, degrees = [TableRow("calibration's sigmas", found.source)], float(np.rad2deg(1.0))
    for error in found.estimated:
        changes = ", ".join(f"{name} {change:+.3g}" for name, change in error.parameters.items())
        size = f"{error.value:+.2f} ± {error.sigma:.2f} sigmas of the stated one"
        words = f"{changes or 'many parameters'}: {size}"
        rows.append(TableRow("calibration, estimated and corrected", words))
    for name, part, unit, scale in (
        ("position", found.position_m, "mm", 1e3),
        ("velocity", found.velocity_m_s, "mm/s", 1e3),
        ("attitude", found.attitude_rad, "deg", degrees),
        ("angular velocity", found.angular_velocity_rad_s, "deg/s", degrees),
        ("centre of mass", found.com_m, "mm", 1e3),
        ("principal axes", found.axes_rad, "deg", degrees),
        ("inertia ratio k1", found.k1, "", 1.0),
        ("inertia ratio k2", found.k2, "", 1.0),
    ):
        images = "no bound" if part.images is None else f"{scale * part.images:.3g}"
        value = f"{images} by the images, {scale * part.calibration:.2g} by the calibration"
        rows.append(TableRow(f"σ {name}, at the end", value, unit))
    return rows


def timing_rows(summary: Summary) -> list[tuple[str, float, float]]:
    """(stage, seconds, share of the longest); without the report, which is timed after it is made."""
    times = {name: getattr(summary.timing_s, name) for name in type(summary.timing_s).model_fields}
    stages = {name: s for name, s in times.items() if s > 0 and name not in ("total", "report", "ipopt")}
    longest = max(stages.values(), default=1.0)
    return [(name, seconds, seconds / longest) for name, seconds in stages.items()]


def metric_rows(metrics: dict[str, Any]) -> list[TableRow]:
    """metrics.json, one line a number; a nested group gives its name to its members.

    Beside a NEES and a coverage stands what is expected if the sigmas are right.
    """
    rows = []
    for key, value in metrics.items():
        if not isinstance(value, dict):
            rows.append(TableRow(_plain(key), _number(key, value)))
            continue
        for name, part in value.items():
            expected = expected_range(key, name)
            words, holds = "", True
            if expected is not None and part is not None:
                words = f"expected {expected[0]:.2g} to {expected[1]:.3g}"
                holds = expected[0] <= part <= expected[1]
            elif key == IN_INTERVAL:
                words, holds = "expected True", bool(part)
            member = f"{name} s after the last image" if name.isdigit() else _plain(name)
            aligned = f", {ALIGNED[key]}" if key in ALIGNED else ""
            text = _number(key if key.endswith("_m") else name, part)
            rows.append(TableRow(f"{_plain(key)}: {member}{aligned}", text, words, determined=holds))
    return rows


def _number(key: str, value: Any) -> str:
    """A value of metrics.json as text, metres in millimetres."""
    if isinstance(value, list):
        return ", ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{(1e3 if key.endswith(('_m', '_m_s')) else 1.0) * value:.4g}"
    return "–" if value is None else str(value)


def _plain(key: str) -> str:
    """rmse_angular_velocity_deg_s -> RMSE angular velocity [deg/s]; completeness_3mm stays a share."""
    key = re.sub(r"^(rmse|nees)(?=_|$)", lambda word: word[0].upper(), key)
    units = {"_deg_s": "deg/s", "_m_s": "mm/s", "_deg": "deg", "_mm": "mm", "_m": "mm", "_s": "s"}
    for suffix, unit in units.items():
        if key.endswith(suffix):
            return f"{key.removesuffix(suffix).replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


def mesh_rows(summary: Summary) -> list[TableRow]:
    """Empty where there is no mesh."""
    rows = []
    if (mesh := summary.mesh) is not None:
        is_albedo = mesh.colour == "albedo"
        invented = f"{mesh.invented_faces} ({mesh.invented_share:.2%} of the area)"
        rows += [
            TableRow("faces", f"{mesh.faces}, {'closed' if mesh.closed else 'open'}"),
            TableRow("small holes closed, left open", f"{mesh.holes_closed}, {mesh.holes_left_open}"),
            TableRow("faces invented for them", invented),
            TableRow("colours", "the Sun's shading divided out" if is_albedo else "as the images"),
        ]
        if (sun := mesh.sun) is not None:
            direction = ", ".join(f"{part:.3f}" for part in sun.direction_N)
            spread = "" if sun.sigma_deg is None else f" ± {sun.sigma_deg:.1f} deg"
            used = "" if is_albedo else ", not used"
            rows.append(TableRow("direction of the Sun in N", f"{direction}{spread}"))
            rows.append(TableRow("changes of brightness it explains", f"{sun.explained:.0%}{used}"))
        for level in mesh.levels:
            mean_mm, most_mm = 1e3 * level.mean_distance_m, 1e3 * level.largest_distance_m
            away = f"off by {mean_mm:.2g} mm in the mean, {most_mm:.2g} mm at most"
            rows.append(TableRow(level.file, f"{level.faces} faces, {away}"))
    if (coverage := summary.coverage) is not None:
        of = "surface" if coverage.of == "mesh" else "convex hull"
        shares = (coverage.seen, coverage.seen_unlit, coverage.unseen)
        name = f"share of the {of} seen lit, seen unlit, unseen"
        rows.append(TableRow(name, ", ".join(f"{part:.1%}" for part in shares)))
    return rows


def mesh_sentences(summary: Summary) -> list[str]:
    """What was not seen, and the mass distribution compared with the volume."""
    sentences = [] if summary.coverage is None else [summary.coverage.words]
    return [*sentences, *(summary.physics.words if summary.physics is not None else ())]


def motion_sentence(estimate: MotionEstimate, frames_used: int, bounded: Intervals | None = None) -> str:
    """The motion in a sentence; bounded: of what it does not determine, where that is known already."""
    rate_rpm = float(np.median(np.linalg.norm(estimate.w_P, axis=1))) * 30.0 / np.pi
    mass, ratios = estimate.mass, []
    for n, name in enumerate(("k1", "k2")):
        if getattr(mass.identifiable, name):
            ratios.append(f"{name} {getattr(mass, name):.4f} +- {np.sqrt(mass.cov_k[n, n]):.4f}")
            continue
        ratios.append(f"{name} not determined by this motion")
        if bounded is not None and (interval := getattr(bounded, name)) is not None:
            ratios[-1] += f" (from {interval[0]:.2f} to {interval[1]:.2f} is possible)"
    return (
        f"{frames_used} of {len(estimate.X_NG)} frames: the target rotates at {rate_rpm:.2f} RPM; "
        f"{', '.join(ratios)}; {len(estimate.landmarks.p_G)} landmarks"
    )
