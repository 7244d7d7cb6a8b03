"""Images to report on simulated scenes: errors, consistency and limits, the tables of docs/scenes.md.

    python -m lab.end_to_end.scenes [CONFIG ...]

Scenes: configs/ts38.yaml and configs/scenes/ unless named. Sequences go to data/, runs with
configs/default.yaml to runs/; what is there already is not made again, so that an interrupted benchmark goes
on.

First table: errors. Second: whether the sigmas are consistent (normalised squared errors over their
expectation; share of the states' components within three sigma), the prediction 30 s ahead, and what limits
the answer.
"""

import json
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from lab.command import ROOT, command, evaluated_run
from lab.presentation import Row, print_table

ERRORS = (
    "scene | position [mm] | velocity [mm/s] | w [deg/s] | attitude [deg] | error k1 (sigma) | "
    "error k2 (sigma) | com [mm] | chamfer [mm] (within 3 mm) | pairs | seconds"
)
CONSISTENCY = (
    "scene | NEES r | v | attitude | w | inertia | com | within 3 sigma: r [%] | v | attitude | w | "
    "30 s ahead | limited by"
)
COMPONENTS = {"position": 3, "velocity": 3, "attitude": 3, "angular_velocity": 3, "inertia": 5, "com": 3}


def main(
    configs: Positional[Annotated[tuple[Path, ...], arg(help="Configurations of scenes.")]] = (),
    run: Annotated[
        Path | None, arg(metavar="RUN", help="An evaluated run instead of those of scenes.")
    ] = None,
) -> None:
    """Make what is missing, print the tables."""
    scenes = configs or [ROOT / "configs/ts38.yaml", *sorted((ROOT / "configs/scenes").glob("*.yaml"))]
    runs = {each.stem: evaluated_run(each) for each in scenes} if run is None else {run.name: run}
    results = {
        name: (_content(each / "metrics.json"), _content(each / "summary.json"))
        for name, each in runs.items()
    }
    for head, row in ((ERRORS, errors_row), (CONSISTENCY, consistency_row)):
        rows = [
            row(name, metrics, summary) if metrics else failed_row(name, head, summary)
            for name, (metrics, summary) in results.items()
        ]
        print()
        print_table(head, rows)
    shares = [
        share
        for metrics, _ in results.values()
        for share in metrics.get("coverage_3sigma", {}).values()
        if share is not None
    ]
    if shares:
        print(f"\nWithin three sigma over {len(results)} scenes: {sum(shares) / len(shares):.2%}")


def _content(file: Path) -> dict[str, Any]:
    """Of a JSON file; nothing where there is none, as of a run that failed."""
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}


def failed_row(name: str, head: str, summary: dict[str, Any]) -> Row:
    """A scene without a motion: its message in place of the numbers."""
    return [name, f"failed: {summary['warnings'][0]}", *[""] * (head.count("|") - 1)]


def errors_row(name: str, metrics: dict[str, Any], summary: dict[str, Any]) -> Row:
    """One scene as a row of the first table."""
    mesh, known, covariance = metrics["mesh"], summary["identifiable"], summary["inertia"]["cov"]
    return [
        _with_status(name, summary),
        f"{1e3 * metrics['rmse_position_m']:.3f}",
        f"{1e3 * metrics['rmse_velocity_m_s']:.3f}",
        f"{metrics['rmse_angular_velocity_deg_s']:.4f}",
        f"{metrics['attitude_error_deg']['median']:.4f}",
        *(
            f"{metrics[f'error_k{n}']:+.5f} ({covariance[n - 1][n - 1] ** 0.5:.5f})"
            if known[f"k{n}"]
            else "not determined"
            for n in (1, 2)
        ),
        f"{metrics['error_com_mm']:.3f}" if known["com"] else "not determined",
        f"{mesh['chamfer_mm']:.2f} ({mesh['completeness_3mm']:.3f})",
        f"{summary['frames_used']} of {summary['frames']}",
        f"{summary['timing_s']['total']:.0f}",
    ]


def _with_status(name: str, summary: dict[str, Any]) -> str:
    """The scene, and what its run says of itself if it is not "ok"."""
    return name if summary["status"] == "ok" else f"{name} ({summary['status']})"


def consistency_row(name: str, metrics: dict[str, Any], summary: dict[str, Any]) -> Row:
    """One scene as a row of the second table."""
    nees, within = metrics["nees"], metrics["coverage_3sigma"]
    ahead = metrics["prediction_error_deg"]["30"], metrics["prediction_error_m"]["30"]
    return [
        _with_status(name, summary),
        *("-" if nees[key] is None else f"{nees[key] / n:.2f}" for key, n in COMPONENTS.items()),
        *(
            "-" if within[key] is None else f"{100 * within[key]:.1f}"
            for key in ("position", "velocity", "attitude", "angular_velocity")
        ),
        "-" if ahead[0] is None else f"{ahead[0]:.2f} deg, {1e3 * ahead[1]:.2f} mm",
        limits(summary),
    ]


def limits(summary: dict[str, Any]) -> str:
    """What limits the accuracy: pixels, disturbances, bridged frames, undetermined quantities."""
    noise = summary["noise"]
    words = [
        f"{noise['pixel_sigma_px']:.2f} px, disparity {noise['disparity_sigma_px']:.2f} px",
        f"disturbances {noise['accel_psd'] ** 0.5:.0e} m/s2, {noise['torque_psd'] ** 0.5:.0e} rad/s2",
    ]
    bridged = summary["frames"] - summary["frames_used"]
    if bridged:
        words.append(f"{bridged} frames bridged")
    hidden = [key for key, text in summary["identifiable_detail"].items() if text.startswith("not")]
    if hidden:
        words.append(f"undetermined: {', '.join(hidden)}")
    return "; ".join(words)


if __name__ == "__main__":
    command(main)
