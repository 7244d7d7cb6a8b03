"""summary.json: the results of a run in one small file (docs/run_directory.md).

Every summary is validated against the models of ``summary_schema`` when it is written and read.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from polhode.atomic import write_text
from polhode.errors import InputError
from polhode.pipeline.run_directory.archives import undetermined_as_inf
from polhode.pipeline.run_directory.summary_schema import (
    Noise,
    ShapeFindings,
    Status,
    Summary,
)
from polhode.records import MassProperties, MotionEstimate, StereoTracks, SurfaceModel

STAGES: tuple[str, ...] = ("frontend", "initialization", "backend", "depth", "fusion", "report", "total")
MANY_CONTRADICTED = 0.4
"""Share of the observations without weight that makes an answer doubtful."""


def build_summary(
    tracks: StereoTracks | None,
    estimate: MotionEstimate | None,
    surface: SurfaceModel | None,
    timing_s: Mapping[str, float],
    warnings: Sequence[str] = (),
    degraded: Sequence[str] = (),
    failure: str | None = None,
    shape: ShapeFindings | None = None,
) -> Summary:
    """The summary of a run.

    ``warnings`` do not change the status (a dropped frame, what the motion does not determine); ``degraded``
    are the caller's reasons to look closely. The status is ``failed`` with a ``failure``, without an
    estimate, or when the solver did not converge; ``degraded`` with a reason of the caller or one of
    ``degradations``; else ``ok``. Every reason stands among the warnings, once, that of a failure first.
    Seconds that ``timing_s`` does not name are 0; ``total`` is their sum unless it is given.
    """
    if failure is None and estimate is not None and not estimate.solver.converged:
        failure = "the solver stopped before convergence"
    reasons = [*degraded, *(degradations(tracks, estimate, surface) if estimate is not None else ())]
    status: Status = "degraded" if reasons else "ok"
    if failure is not None or estimate is None:
        status = "failed"
    own = estimate.warnings if estimate is not None else ()
    reported = [*([failure] if failure else []), *reasons, *_undetermined(estimate)]
    # A warning of the back end that begins with the same text is more detailed.
    reported = [text for text in reported if not any(more.startswith(text) for more in own)]
    shape = shape or ShapeFindings()
    texts = [*reported, *own, *warnings, *shape.warnings]
    if failure is not None:
        texts.sort(key=lambda text: not text.startswith(failure))
    times = {stage: float(timing_s.get(stage, 0.0)) for stage in STAGES}
    times["total"] = times["total"] or sum(times.values())
    found: dict[str, Any] = dict.fromkeys(_OF_THE_ESTIMATE)
    return Summary.model_validate(
        {
            "status": status,
            "warnings": list(dict.fromkeys(texts)),
            "frames": tracks.n_frames if tracks else 0,
            "frames_used": len(np.unique(tracks.frame)) if tracks else 0,
            "landmarks": len(estimate.landmarks.p_G) if estimate else tracks.n_landmarks if tracks else 0,
            "observations": len(tracks.frame) if tracks else 0,
            "duration_s": float(tracks.time_s[-1]) if tracks and tracks.n_frames else 0.0,
            "timing_s": times,
            "assumed": shape.assumed,
            "mesh": shape.mesh,
            "coverage": shape.coverage,
            "physics": shape.physics,
            "identifiable_detail": dict(estimate.mass.identifiable.detail) if estimate else {},
            **(found if estimate is None else _found(estimate)),
        }
    )


def degradations(
    tracks: StereoTracks | None, estimate: MotionEstimate, surface: SurfaceModel | None
) -> tuple[str, ...]:
    """The reasons why the estimate is doubtful or incomplete.

    What is unobservable is no such reason: a spin about one axis, measured well, is a complete answer.
    """
    reasons = []
    if tracks is not None and len(np.unique(tracks.frame)) < 0.5 * tracks.n_frames:
        reasons.append(
            "fewer than half of the frames have measurements; the others are bridged by the dynamics"
        )
    contradicted = float(np.mean(estimate.inlier_weight == 0.0)) if estimate is not None else 0.0
    if contradicted > MANY_CONTRADICTED:
        reasons.append(f"{contradicted:.0%} of the observations contradict the motion")
    if surface is None or len(surface.mesh.faces) == 0:
        reasons.append("there is no surface: the depth maps gave none, or the run ended before them")
    return tuple(reasons)


def _undetermined(estimate: MotionEstimate | None) -> list[str]:
    """What the motion does not determine, as one warning."""
    if estimate is None:
        return []
    known = estimate.mass.identifiable
    flags = {f"com_{axis}": flag for axis, flag in zip("xyz", known.com_P, strict=True)}
    flags |= {"k1": known.k1, "k2": known.k2}
    flags |= {f"axes_{axis}": flag for axis, flag in zip("xyz", known.axes_P, strict=True)}
    names = [name for name, flag in flags.items() if not flag]
    return [f"the motion does not determine: {', '.join(names)}"] if names else []


def write_summary(summary: Summary, path: Path) -> None:
    """Write summary.json, validated once more (pydantic.ValidationError if a copy got a wrong value)."""
    content = summary.model_dump(mode="json", by_alias=True)
    Summary.model_validate(content)
    text = json.dumps(content, indent=2, allow_nan=False)
    # One row of numbers, one line: no JSON string holds a raw line feed, so only arrays are touched.
    text = re.sub(r"\[\n\s*([-+.,\w\s]*?)\n\s*\]", lambda row: f"[{' '.join(row[1].split())}]", text)
    write_text(path, text + "\n")


def read_summary(path: Path) -> Summary:
    """Read summary.json (the file, or its run folder). Raises InputError, one line."""
    file = path / "summary.json" if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the folder of a run")
    try:
        return Summary.model_validate_json(file.read_text())
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise InputError(f"{file}: {where}: {first['msg']}; not a summary that polhode wrote") from error


_OF_THE_ESTIMATE = (
    "inertia",
    "identifiable",
    "identifiable_components",
    "com_G",
    "cov_com_G",
    "R_GP",
    "cov_R_GP",
    "solver",
    "noise",
)


def _found(estimate: MotionEstimate) -> dict[str, Any]:
    mass, known, solver = estimate.mass, estimate.mass.identifiable, estimate.solver
    return {
        "inertia": _inertia(mass),
        "identifiable": {name: bool(getattr(known, name)) for name in ("k1", "k2", "com", "axes")},
        "identifiable_components": {"com_P": known.com_P.tolist(), "axes_P": known.axes_P.tolist()},
        "com_G": mass.com_G.tolist(),
        "cov_com_G": _nullable(mass.cov_com_G),
        "R_GP": mass.R_GP.tolist(),
        "cov_R_GP": _nullable(mass.cov_R_GP),
        "solver": {
            "name": solver.name,
            "iterations": solver.iterations,
            "cost": float(solver.cost),
            "converged": bool(solver.converged),
            "reduced_chi2": _number(solver.reduced_chi2),
            "message": solver.message,
            "runner_up": {name: _number(cost) for name, cost in solver.runner_up.items()},
        },
        "noise": {name: float(getattr(estimate.noise, name)) for name in Noise.model_fields},
        "unknown_pushes": _pushes(estimate),
    }


def _pushes(estimate: MotionEstimate) -> list[dict[str, Any]]:
    first_ns = int(estimate.timestamps_ns[0])
    return [
        {
            "start_s": (push.start_ns - first_ns) * 1e-9,
            "end_s": (push.end_ns - first_ns) * 1e-9,
            "delta_v_N": push.delta_v_N.tolist(),
            "sigma_delta_v_N": [_number(sigma) for sigma in push.sigma_delta_v_N],
            "delta_w_P": push.delta_w_P.tolist(),
            "sigma_delta_w_P": [_number(sigma) for sigma in push.sigma_delta_w_P],
        }
        for push in (estimate.disturbances.impulses if estimate.disturbances is not None else ())
    ]


def _inertia(mass: MassProperties) -> dict[str, Any]:
    return {
        "k1": float(mass.k1),
        "k2": float(mass.k2),
        "cov": _nullable(mass.cov_k),
        "J_G": mass.J_G.tolist(),
        "cov_J": _nullable(mass.cov_J),
        "moments": mass.moments.tolist(),
        "sigma_moments": [_number(sigma) for sigma in mass.sigma_moments],
        "mass_kg": mass.mass_kg,
        "sigma_mass_kg": _sigma(mass.sigma_mass_kg),
        "scale_kg_m2": mass.inertia_scale_kg_m2,
        "sigma_scale_kg_m2": _sigma(mass.sigma_inertia_scale_kg_m2),
    }


def _sigma(value: float | None) -> float | None:
    return None if value is None else _number(value)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _nullable(covariance: NDArray[np.float64]) -> list[list[float | None]]:
    """Undetermined rows and columns are null as a whole: their covariances mean nothing."""
    unknown = np.isinf(np.diagonal(undetermined_as_inf(covariance)))
    hidden = unknown[:, None] | unknown[None, :]
    return [
        [None if hide else float(value) for value, hide in zip(row, hide_row, strict=True)]
        for row, hide_row in zip(covariance, hidden, strict=True)
    ]
