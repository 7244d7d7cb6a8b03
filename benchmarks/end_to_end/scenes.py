"""Images to report on simulated scenes: simulate, run with configs/default.yaml, evaluate, print a row.

    python -m benchmarks.end_to_end.scenes [CONFIG ...] [--again] [--features both|rootsift|polhode|always]

Scenes: configs/ts38.yaml and configs/scenes/ unless named. Sequences go to data/, runs to runs/; what is
there already is not made again, so an interrupted benchmark resumes. ``--again`` repeats the runs.
``--features`` leaves out one of the two methods of the front end, or makes the consistency check in every
run; those runs go to runs/rootsift_*, runs/polhode_* and runs/always_*.

First table: errors. Second: whether the sigmas are consistent (normalised squared errors over their
expectation; share of the states' components within three sigma), the prediction 30 s ahead, and what limits
the answer.
"""

import json
import shutil
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from benchmarks.command import DEFAULT, ROOT, command, polhode, simulated
from benchmarks.presentation import Row, print_table

HEAD = (
    "scene | position [mm] | velocity [mm/s] | w [deg/s] | attitude [deg] | error k1 (sigma) | "
    "error k2 (sigma) | com [mm] | chamfer [mm] (within 3 mm) | pairs | seconds"
)

CONSISTENCY = (
    "scene | NEES r | v | attitude | w | inertia | com | within 3 sigma: r [%] | v | attitude | w | "
    "30 s ahead | limited by"
)
FEATURES = {
    "both": (),
    "rootsift": ("--frontend.features.second", "None"),
    "polhode": ("--frontend.features.method", "polhode"),
    "always": ("--frontend.features.second-below", "1000000"),
}
NEES = {"position": 3, "velocity": 3, "attitude": 3, "angular_velocity": 3, "inertia": 5, "com": 3}


def main(
    configs: Positional[Annotated[tuple[Path, ...], arg(help="Configurations of scenes.")]] = (),
    again: Annotated[bool, arg(help="Repeat runs that exist.")] = False,
    features: Annotated[
        Literal["both", "rootsift", "polhode", "always"], arg(help="Methods of the front end.")
    ] = "both",
) -> None:
    """Make what is missing and print the table."""
    chosen = configs or [
        ROOT / "configs/ts38.yaml",
        *sorted((ROOT / "configs/scenes").glob("*.yaml")),
    ]
    results = [(config.stem, *measure(config, again, features)) for config in chosen]
    for head, row in ((HEAD, row_of), (CONSISTENCY, consistency_row)):
        print()
        print_table(
            head,
            (
                failed_row(name, head, summary) if metrics is None else row(name, metrics, summary)
                for name, metrics, summary in results
            ),
        )
    measured = [metrics for _, metrics, _ in results if metrics is not None]
    shares = [part for m in measured for part in m["coverage_3sigma"].values() if part is not None]
    print(f"\nWithin three sigma over {len(measured)} scenes: {sum(shares) / len(shares):.2%}")


def measure(
    config: Path, again: bool, features: str = "both"
) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Simulate, run and evaluate one scene; metrics.json, None after a failure, and summary.json."""
    name = config.stem if features == "both" else f"{features}_{config.stem}"
    sequence, run = ROOT / "data" / config.stem, ROOT / "runs" / name
    simulated(config, sequence)
    if again or not (run / "summary.json").is_file():
        shutil.rmtree(run, ignore_errors=True)
        # a run that fails says so in summary.json
        polhode("run", DEFAULT, "--data", sequence, "-o", run, *FEATURES[features], may_fail=True)
    if not (run / "summary.json").is_file():
        raise SystemExit(f"{config.stem}: the run left no summary.json")
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    if not (run / "trajectory.csv").is_file():
        return None, summary
    if not (run / "metrics.json").is_file():
        polhode("evaluate", run, sequence)
    return json.loads((run / "metrics.json").read_text(encoding="utf-8")), summary


def failed_row(name: str, head: str, summary: dict[str, Any]) -> Row:
    """A scene without a motion: its message in place of the numbers."""
    return [name, f"failed: {summary['warnings'][0]}", *[""] * (head.count("|") - 1)]


def row_of(name: str, metrics: dict[str, Any], summary: dict[str, Any]) -> Row:
    """One scene as a row of the table."""
    mesh, known = metrics["mesh"], summary["identifiable"]
    return [
        _with_status(name, summary),
        f"{1e3 * metrics['rmse_position_m']:.3f}",
        f"{1e3 * metrics['rmse_velocity_m_s']:.3f}",
        f"{metrics['rmse_angular_velocity_deg_s']:.4f}",
        f"{metrics['attitude_error_deg']['median']:.4f}",
        *(
            ratio(metrics[f"error_k{n}"], summary["inertia"]["cov"][n - 1][n - 1], known[f"k{n}"])
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
    nees, coverage, noise = metrics["nees"], metrics["coverage_3sigma"], summary["noise"]
    ahead = metrics["prediction_error_deg"]["30"], metrics["prediction_error_m"]["30"]
    return [
        _with_status(name, summary),
        *(share(nees[key], components) for key, components in NEES.items()),
        *(percent(coverage[key]) for key in ("position", "velocity", "attitude", "angular_velocity")),
        "-" if ahead[0] is None else f"{ahead[0]:.2f} deg, {1e3 * ahead[1]:.2f} mm",
        limits(noise, summary),
    ]


def limits(noise: dict[str, Any], summary: dict[str, Any]) -> str:
    """What limits the accuracy: pixels, disturbances, bridged frames, undetermined quantities."""
    words = [
        f"{noise['pixel_sigma_px']:.2f} px, disparity {noise['disparity_sigma_px']:.2f} px",
        f"disturbances {noise['accel_psd'] ** 0.5:.0e} m/s2, {noise['torque_psd'] ** 0.5:.0e} rad/s2",
    ]
    lost = summary["frames"] - summary["frames_used"]
    if lost:
        words.append(f"{lost} frames bridged")
    hidden = [key for key, text in summary["identifiable_detail"].items() if text.startswith("not")]
    if hidden:
        words.append(f"undetermined: {', '.join(hidden)}")
    return "; ".join(words)


def share(value: float | None, components: int) -> str:
    """A normalised squared error over its expectation."""
    return "-" if value is None else f"{value / components:.2f}"


def percent(value: float | None) -> str:
    """A share."""
    return "-" if value is None else f"{100 * value:.1f}"


def ratio(error: float, variance: float | None, known: bool) -> str:
    """Error and sigma of an inertia ratio; the error of an undetermined ratio means nothing."""
    return f"{error:+.5f} ({variance**0.5:.5f})" if known and variance is not None else "not determined"


if __name__ == "__main__":
    command(main)
