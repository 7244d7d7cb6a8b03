"""How the status of a run is decided: "failed", "degraded" or "ok".

- failed: a stage failed, there is no estimate, or the solver did not converge.
- degraded: a check does not hold, of the data, of the answer, or of the estimate as such (here).
- ok: otherwise. What the motion does not determine is no doubt: a spin about one axis, measured well, is a
  complete answer.

The limits of the checks, and the reasons that they give, are in ``check_table``.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from polhode.records.estimate import MotionEstimate
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import make_check
from polhode.run_directory.summary_schema import Check, CheckVerdict, Status, Summary, Verdict


def decide_verdict(failure: str | None, estimate: MotionEstimate | None, checks: Sequence[Check]) -> Verdict:
    """Status and reasons, that of a failure first, from all checks of a run."""
    if failure is None and estimate is not None and not estimate.solver.converged:
        failure = "the solver stopped before convergence"
    reasons = [*([failure] if failure else []), *reasons_of(checks)]
    status: Status = "degraded" if reasons else "ok"
    if failure is not None or estimate is None:
        status = "failed"
    return Verdict(
        status=status, reasons=tuple(dict.fromkeys(reasons)), checks=tuple(map(_expected_and_found, checks))
    )


def reasons_of(checks: Iterable[Check]) -> list[str]:
    """Of the checks that do not hold."""
    return [check.reason for check in checks if check.reason]


def _expected_and_found(check: Check) -> CheckVerdict:
    """A check as the verdict has it. No value of a check has a meaning below 0, where 0 is the best."""
    decides = check.value is not None and check.limit is not None
    return CheckVerdict(
        name=check.name,
        value=check.value,
        expected=(check.limit, None) if check.at_least else (0.0, check.limit),
        holds=not check.reason if decides else None,
    )


def rotation_check(estimate: MotionEstimate) -> Check:
    """Whether the images leave more than one rotation between pairs."""
    found = estimate.hypotheses
    turns = " or ".join(f"{each.turn_deg:.0f}" for each in found)
    odds = " : ".join(f"{100.0 * each.odds:.0f}" for each in found)
    other = 100.0 * sum(each.odds for each in found[1:])
    return make_check("rotation", other, turns=turns, odds=odds)


def estimate_checks(
    tracks: StereoTracks | None, estimate: MotionEstimate, surface: SurfaceModel | None
) -> list[Check]:
    """Whether the estimate is complete, and fits its measurements."""
    used = 1.0 if tracks is None else len(np.unique(tracks.frame)) / max(tracks.n_frames, 1)
    outliers = float(np.mean(estimate.inlier_weight == 0.0)) if len(estimate.inlier_weight) else 0.0
    return [
        make_check("frames", 100.0 * used),
        make_check("outliers", 100.0 * outliers),
        make_check("disturbances", estimate.noise.times_stated),
        make_check("surface", 0 if surface is None else len(surface.mesh.faces)),
    ]


def lower_status(summary: Summary, status: Status, reason: str, first: bool = False) -> Summary:
    """With a worse status, and the reason among the warnings and in the verdict, last or first."""

    def with_reason(texts: Iterable[str]) -> list[str]:
        return list(dict.fromkeys([reason, *texts] if first else [*texts, reason]))

    verdict = summary.verdict
    if verdict is not None:
        reasons = tuple(with_reason(verdict.reasons))
        verdict = verdict.model_copy(update={"status": status, "reasons": reasons})
    changes = {"status": status, "warnings": with_reason(summary.warnings), "verdict": verdict}
    return summary.model_copy(update=changes)
