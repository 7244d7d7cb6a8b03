"""Images to report on simulated scenes: simulate, run with configs/default.yaml, evaluate, print a row.

    python -m benchmarks.scenes [CONFIG ...] [--again]

Scenes: configs/ts38.yaml and configs/scenes/ unless named. Sequences go to data/, runs to runs/; what is
there already is not made again, so an interrupted benchmark resumes. ``--again`` repeats the runs.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
HEAD = (
    "scene | position [mm] | velocity [mm/s] | w [deg/s] | attitude [deg] | error k1 (sigma) | "
    "error k2 (sigma) | com [mm] | chamfer [mm] (within 3 mm) | pairs | seconds"
)


def main() -> None:
    """Make what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("configs", nargs="*", type=Path, help="scene configurations")
    parser.add_argument("--again", action="store_true", help="repeat runs that exist")
    options = parser.parse_args()
    configs = options.configs or [
        ROOT / "configs/ts38.yaml",
        *sorted((ROOT / "configs/scenes").glob("*.yaml")),
    ]
    rows = [measure(config, options.again) for config in configs]
    print(f"| {HEAD} |")
    print("|" + "---|" * (HEAD.count("|") + 1))
    for row in rows:
        print(row)


def measure(config: Path, again: bool) -> str:
    """Simulate, run and evaluate one scene; its row of the table."""
    sequence, run = ROOT / "data" / config.stem, ROOT / "runs" / config.stem
    if not (sequence / "mav0").is_dir():
        polhode("simulate", str(config), "-o", str(sequence))
    if again or not (run / "metrics.json").is_file():
        polhode(
            "run", str(ROOT / "configs/default.yaml"), "--data", str(sequence), "-o", str(run), "--overwrite"
        )
        polhode("evaluate", str(run), str(sequence))
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    return row_of(config.stem, metrics, summary)


def polhode(*arguments: str) -> None:
    """The program, as a user calls it."""
    subprocess.run([sys.executable, "-m", "pipeline", *arguments], cwd=ROOT, check=True)


def row_of(name: str, metrics: dict[str, Any], summary: dict[str, Any]) -> str:
    """One scene as a row of the table."""
    mesh, known = metrics["mesh"], summary["identifiable"]
    cells = [
        name,
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
    return "| " + " | ".join(cells) + " |"


def ratio(error: float, variance: float | None, known: bool) -> str:
    """Error and sigma of an inertia ratio; the error of what the motion does not tell means nothing."""
    return f"{error:+.5f} ({variance**0.5:.5f})" if known and variance is not None else "not determined"


if __name__ == "__main__":
    main()
