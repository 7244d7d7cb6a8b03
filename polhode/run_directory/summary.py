"""summary.json: the results of a run in one small file (docs/run_directory.md).

Every summary is validated against the models of ``summary_schema`` when it is written and read.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from polhode.files.atomic import write_text
from polhode.files.json_files import read_json
from polhode.files.output.exchange import entries
from polhode.files.output.run_files import is_run_file, is_stage_file
from polhode.records.estimate import MotionEstimate, RotationHypothesis
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import StereoTracks
from polhode.run_directory.archives import undetermined_as_inf
from polhode.run_directory.last_rotation import last_rotation
from polhode.run_directory.own_results import digests, require_own_results
from polhode.run_directory.summary_schema import (
    ESTIMATE_PARTS,
    Check,
    IpoptSummary,
    Noise,
    ShapeFindings,
    StageTimes,
    Summary,
    content_digest,
    json_text,
)
from polhode.run_directory.verdict import decide_verdict, estimate_checks, rotation_check
from polhode.runtime.errors import InputError

NOT_OURS = "not a summary that polhode wrote"
MAX_SIZE = 1e12
"""Of a moment over the middle one, and of com_G [m]."""


def build_summary(
    tracks: StereoTracks | None,
    estimate: MotionEstimate | None,
    surface: SurfaceModel | None,
    timing_s: Mapping[str, float],
    warnings: Sequence[str] = (),
    *,
    failure: str | None = None,
    shape: ShapeFindings | None = None,
    checks: Sequence[Check] = (),
) -> Summary:
    """The summary of a run, its status as ``decide_verdict`` finds it.

    ``warnings`` do not change the status (a dropped frame, what the motion does not determine). Every reason
    stands among the warnings, once, that of a failure first. Seconds that ``timing_s`` does not name are 0;
    ``total`` is their sum unless it is given. Whoever has intervals adds them.
    """
    if estimate is not None:
        checks, rotation = [*checks, *estimate_checks(tracks, estimate, surface)], rotation_check(estimate)
        # where it does not hold, it is the first that a user should know
        checks = [rotation, *checks] if rotation.reason else [*checks, rotation]
    verdict = decide_verdict(failure, estimate, checks)
    own, reported = estimate.warnings if estimate is not None else (), list(verdict.reasons)
    if estimate is not None:
        known = estimate.mass.identifiable
        names = [f"com_{axis}" for axis, flag in zip("xyz", known.com_P, strict=True) if not flag]
        names += [name for name in ("k1", "k2") if not getattr(known, name)]
        names += [f"axes_{axis}" for axis, flag in zip("xyz", known.axes_P, strict=True) if not flag]
        reported += [f"the motion does not determine: {', '.join(names)}"] if names else []
    # A warning of the back end that begins with the same text is more detailed.
    reported = [text for text in reported if not any(more.startswith(text) for more in own)]
    shape = shape or ShapeFindings()
    texts = [*reported, *own, *warnings, *shape.warnings]
    if verdict.status == "failed" and verdict.reasons:
        texts.sort(key=lambda text: not text.startswith(verdict.reasons[0]))
    times = {stage: float(timing_s.get(stage, 0.0)) for stage in StageTimes.model_fields}
    times["total"] = times["total"] or sum(times.values())
    times["ipopt"] = 0.0
    if estimate is not None and estimate.solver.ipopt is not None:
        times["ipopt"] = estimate.solver.ipopt.seconds
    return Summary.model_validate(
        {
            "status": verdict.status,
            "warnings": list(dict.fromkeys(texts)),
            "frames": tracks.n_frames if tracks else 0,
            "frames_used": len(np.unique(tracks.frame)) if tracks else 0,
            "landmarks": len(estimate.landmarks.p_G) if estimate else tracks.n_landmarks if tracks else 0,
            "observations": len(tracks.frame) if tracks else 0,
            "duration_s": float(tracks.time_s[-1]) if tracks and tracks.n_frames else 0.0,
            "timing_s": times,
            "checks": tuple(checks),
            "verdict": verdict,
            "assumed": shape.assumed,
            "mesh": shape.mesh,
            "coverage": shape.coverage,
            "physics": shape.physics,
            "intervals": None,
            "identifiable_detail": dict(estimate.mass.identifiable.detail) if estimate else {},
            **(dict.fromkeys(ESTIMATE_PARTS) if estimate is None else _estimate_parts(estimate)),
        }
    )


def with_files(summary: Summary, folder: Path) -> Summary:
    """The summary, with the names of the run's files in ``folder``, and digests of its results."""
    names = sorted(
        name
        for name, is_folder in entries(folder)
        if not is_folder and is_run_file(name) and not is_stage_file(name)
    )
    return summary.model_copy(update={"files": tuple(names), "sha256": digests(folder, names)})


def write_summary(summary: Summary, path: Path) -> None:
    """Write summary.json, validated once more (pydantic.ValidationError if a copy got a wrong value)."""
    plain = json.loads(json_text(summary))
    text = json_text(summary.model_copy(update={"own_sha256": content_digest(plain)}))
    Summary.model_validate_json(text)
    write_text(path, text)


def read_summary(path: Path) -> Summary:
    """Read summary.json (the file, or its run folder). Raises InputError, one line.

    Of a folder, the run's results must be those that it wrote (``own_results``).
    """
    file = path / "summary.json" if path.is_dir() else path
    if not file.exists():
        raise InputError(f"{file}: no such file; give the folder of a run")
    content = read_json(file, "a summary")
    try:
        summary = Summary.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        where = ".".join(str(part)[:60] for part in first["loc"][:6]) or "the file"
        what = first["msg"].removeprefix("Value error, ")[:200]
        raise InputError(f"{file}: {where}: {what}; {NOT_OURS}") from None
    _require_sound(file, summary)
    if summary.own_sha256 not in (None, content_digest(content)):
        raise InputError(
            f"{file}: changed since the run wrote it (own_sha256 is of other content); put the run's own "
            "file back, or run again"
        )
    if file != path:
        require_own_results(path, summary.sha256)
    return summary.model_copy(update={"own_sha256": None})


def _require_sound(file: Path, summary: Summary) -> None:
    """Raise InputError for numbers that no run finds, and that no later step could use."""
    wrong = []
    if summary.R_GP is not None:
        R = np.array(summary.R_GP)
        off = np.inf if np.abs(R).max() >= 2.0 else np.abs(R @ R.T - np.eye(3)).max()
        wrong += ["R_GP: not a rotation"] if off >= 1e-6 or np.linalg.det(R) <= 0.0 else []
    if summary.com_G is not None and np.abs(summary.com_G).max() > MAX_SIZE:
        wrong.append(f"com_G: above {MAX_SIZE:g} m")
    if (inertia := summary.inertia) is not None:
        if not all(1.0 / MAX_SIZE <= each <= MAX_SIZE for each in inertia.moments):
            wrong.append("inertia.moments: not three positive moments about 1")
        J = np.array(inertia.J_G)
        is_symmetric = np.abs(J).max() <= MAX_SIZE and np.abs(J - J.T).max() <= 1e-6 * np.abs(J).max()
        if not is_symmetric or np.linalg.eigvalsh(J)[0] <= 0.0:
            wrong.append("inertia.J_G: not symmetric and positive definite")
        if max(abs(inertia.k1), abs(inertia.k2)) > 60.0:
            wrong.append("inertia: k1 and k2 beyond 60")
    powers = () if summary.noise is None else (summary.noise.accel_psd, summary.noise.torque_psd)
    if not all(0.0 <= psd <= MAX_SIZE for psd in powers):
        wrong.append(f"noise: accel_psd or torque_psd is not from 0 to {MAX_SIZE:g}")
    if wrong:
        raise InputError(f"{file}: {wrong[0]}; {NOT_OURS}")


def _hypothesis(found: RotationHypothesis, number: int) -> dict[str, Any]:
    """A hypothesis as the summary has it."""
    w_N = found.R_NG @ found.w_G
    rate = float(np.linalg.norm(w_N))
    turn = f"rotation by {found.turn_deg:.0f} degrees between pairs"
    reason = f"{turn}, the most probable one that fits" if number == 0 else f"{turn}: fits as well"
    direction = (w_N / rate if rate > 0.0 else np.array([0.0, 0.0, 1.0])).tolist()
    return {"rate_rpm": rate * 30.0 / np.pi, "direction": direction, "odds": found.odds, "reason": reason}


def _estimate_parts(estimate: MotionEstimate) -> dict[str, Any]:
    """The parts of the summary that take an estimate."""
    mass, known, solver = estimate.mass, estimate.mass.identifiable, estimate.solver
    first_ns = int(estimate.timestamps_ns[0])
    impulses = estimate.disturbances.impulses if estimate.disturbances is not None else ()
    ipopt = None
    if solver.ipopt is not None:
        ipopt = {name: getattr(solver.ipopt, name) for name in IpoptSummary.model_fields}
    return {
        "inertia": {
            **{name: getattr(mass, name) for name in ("k1", "k2", "J_G", "moments", "sigma_moments")},
            "cov": nullable(mass.cov_k),
            "cov_J": nullable(mass.cov_J),
            "mass_kg": mass.mass_kg,
            "sigma_mass_kg": mass.sigma_mass_kg,
            "scale_kg_m2": mass.inertia_scale_kg_m2,
            "sigma_scale_kg_m2": mass.sigma_inertia_scale_kg_m2,
        },
        "identifiable": {name: bool(getattr(known, name)) for name in ("k1", "k2", "com", "axes")},
        "identifiable_components": {"com_P": known.com_P.tolist(), "axes_P": known.axes_P.tolist()},
        "com_G": mass.com_G,
        "cov_com_G": nullable(mass.cov_com_G),
        "R_GP": mass.R_GP,
        "cov_R_GP": nullable(mass.cov_R_GP),
        "rotation": last_rotation(estimate),
        "solver": vars(solver) | {"converged": bool(solver.converged), "ipopt": ipopt},
        "noise": {name: getattr(estimate.noise, name) for name in Noise.model_fields},
        "hypotheses": [_hypothesis(each, number) for number, each in enumerate(estimate.hypotheses)],
        "calibration": calibration_sigmas(estimate),
        "unknown_pushes": [
            {
                "start_s": (impulse.start_ns - first_ns) * 1e-9,
                "end_s": (impulse.end_ns - first_ns) * 1e-9,
                **{name: value for name, value in vars(impulse).items() if not name.endswith("_ns")},
            }
            for impulse in impulses
        ],
    }


def calibration_sigmas(estimate: MotionEstimate) -> dict[str, Any] | None:
    """Parts of the sigmas by images and calibration; None: the calibration is exact."""
    part, mass = estimate.calibration, estimate.mass
    if part is None:
        return None
    last, of_last = np.diag(estimate.covariance[-1]), np.diag(part.last_joint)
    variances = {
        "position_m": (last[:3], of_last[:3]),
        "velocity_m_s": (last[3:6], of_last[3:6]),
        "attitude_rad": (last[6:9], of_last[6:9]),
        "angular_velocity_rad_s": (last[9:], of_last[9:12]),
        "k1": (mass.cov_k[:1, 0], part.cov_k[:1, 0]),
        "k2": (mass.cov_k[1:, 1], part.cov_k[1:, 1]),
        "axes_rad": (np.diag(mass.cov_R_GP), np.diag(part.cov_R_GP)),
        "com_m": (np.diag(mass.cov_com_G), of_last[17:]),
    }
    parts = {
        name: {
            "images": float(np.sqrt(max(np.sum(whole) - np.sum(own), 0.0))),
            "calibration": float(np.sqrt(np.sum(own))),
        }
        for name, (whole, own) in variances.items()
    }
    return {"source": part.source, **parts, "estimated": [vars(each) for each in part.estimated]}


def nullable(covariance: NDArray[np.float64]) -> list[list[float | None]]:
    """Undetermined rows and columns are null as a whole: their covariances mean nothing."""
    unknown = np.isinf(np.diagonal(undetermined_as_inf(covariance)))
    hidden = unknown[:, None] | unknown[None, :]
    return np.where(hidden, None, covariance).tolist()  # type: ignore[call-overload,no-any-return]
