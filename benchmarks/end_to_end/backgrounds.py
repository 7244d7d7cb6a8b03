"""Scenes before Earth and wall, without masks, against the same scenes before a dark sky: errors of the runs.

    python -m benchmarks.end_to_end.backgrounds [CONFIG ...] [--short] [--record FILE]

Each scene is simulated twice, into data/NAME and, without its background, data/NAME_sky; noise, light and
motion are the same. Both are run with configs/default.yaml (runs/NAME, runs/NAME_sky) and evaluated; what
is there already is not made again. Rows: the errors before the background, before the sky, and their ratio.
An error before the sky that is a hundredth of its sigma by chance makes a large ratio, so that the last rows
give the standard deviations that the runs state and their ratio, too.
"""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import DEFAULT, RECORDS, ROOT, Record, Short, command, polhode
from benchmarks.presentation import Row, print_table
from benchmarks.record import Case, complete

SCENES = tuple(
    ROOT / "configs" / f"{name}.yaml"
    for name in ("scenes/earth_behind", "scenes/wall_behind", "backgrounds/limb", "backgrounds/posters")
)
HEAD = (
    "scene | errors | position [mm] | velocity [mm/s] | w [deg/s] | attitude [deg] | axes [deg] | k1 | k2 | "
    "com [mm] | chamfer [mm] | doubtful masks | pairs"
)
FIGURES = ("position", "velocity", "w", "attitude", "axes", "k1", "k2", "com", "chamfer")
DIGITS = {
    "position": 3,
    "velocity": 3,
    "w": 4,
    "attitude": 4,
    "axes": 3,
    "k1": 5,
    "k2": 5,
    "com": 3,
    "chamfer": 2,
}
NO_BACKGROUND = (
    *("--scene.background.earth", "False", "--scene.background.stars", "False"),
    *("--scene.background.wall.distance-m", "0"),
)
QUICK = ("--scene.frames", "8", "--scene.render.samples", "1", "--scene.render.bounces", "0")
DOUBTFUL = "pairs with doubtful segmentation masks"
MAX_FACTOR = 1.5
"""Between the errors before a background and before a dark sky, by which the scenes are judged."""


def main(
    configs: Positional[Annotated[tuple[Path, ...], arg(help="Configurations of scenes.")]] = (),
    short: Short = False,
    record: Record = RECORDS / "backgrounds",
) -> None:
    """Make what is missing and print the table."""
    chosen = configs or (SCENES[:1] if short else SCENES)
    names = [str(path.resolve().relative_to(ROOT)) for path in chosen]
    cases: list[Case] = [{"config": name, "short": short} for name in names]
    lines = complete(record if not short else ROOT / "runs/records/backgrounds_short", cases, measure, 1)
    print_table(HEAD, [row for line in lines for row in rows_of(line)])
    print(f"\n{verdict(lines)}")


def measure(case: Case) -> Case:
    """The figures of a scene before its background and before the sky."""
    config, short = ROOT / case["config"], bool(case["short"])
    name = f"{config.stem}_short" if short else config.stem
    more = QUICK if short else ()
    return {
        "background": _figures(config, name, more),
        "sky": _figures(config, f"{name}_sky", (*more, *NO_BACKGROUND)),
    }


def _figures(config: Path, name: str, overrides: tuple[str, ...]) -> dict[str, Any]:
    sequence, run = ROOT / "data" / name, ROOT / "runs" / name
    if not (sequence / "mav0").is_dir():
        sequence.parent.mkdir(parents=True, exist_ok=True)
        polhode("simulate", config, "-o", sequence, *overrides)
    if not (run / "summary.json").is_file():
        polhode("run", DEFAULT, "--data", sequence, "-o", run, "--pictures.animation", "False", may_fail=True)
    if not (run / "metrics.json").is_file():
        polhode("evaluate", run, sequence)
    metrics, summary = (json.loads((run / f"{file}.json").read_text()) for file in ("metrics", "summary"))
    return figures(metrics, summary, run)


def figures(metrics: dict[str, Any], summary: dict[str, Any], run: Path) -> dict[str, Any]:
    """Errors and the standard deviations that the run states, of what the table shows."""
    checks = {check["name"]: check["value"] for check in summary["verdict"]["checks"]}
    known, cov = summary["identifiable"], summary["inertia"]["cov"]
    errors = {
        "position": 1e3 * metrics["rmse_position_m"],
        "velocity": 1e3 * metrics["rmse_velocity_m_s"],
        "w": metrics["rmse_angular_velocity_deg_s"],
        "attitude": metrics["attitude_error_deg"]["median"],
        "axes": metrics["principal_axes_error_deg"] if known["axes"] else None,
        "k1": abs(metrics["error_k1"]) if known["k1"] else None,
        "k2": abs(metrics["error_k2"]) if known["k2"] else None,
        "com": metrics["error_com_mm"] if known["com"] else None,
        "chamfer": metrics["mesh"]["chamfer_mm"],
    }
    sigma = {
        **_sigma_of_states(run),
        "k1": float(np.sqrt(cov[0][0])) if known["k1"] else None,
        "k2": float(np.sqrt(cov[1][1])) if known["k2"] else None,
        "com": 1e3 * float(np.sqrt(np.trace(summary["cov_com_G"]))) if known["com"] else None,
    }
    return {
        "errors": errors,
        "sigma": sigma,
        "doubtful": checks.get(DOUBTFUL),
        "pairs": [summary["frames_used"], summary["frames"]],
        "status": summary["status"],
    }


def _sigma_of_states(run: Path) -> dict[str, float | None]:
    """Root mean square over the frames of the norm of each state's sigma; None: infinite."""
    table = np.genfromtxt(run / "trajectory.csv", delimiter=",", skip_header=1)
    found = {}
    for name, first, unit in (("position", 14, 1e3), ("velocity", 17, 1e3), ("w", 23, 180.0 / np.pi)):
        value = unit * float(np.sqrt(np.mean(np.sum(table[:, first : first + 3] ** 2, axis=1))))
        found[name] = value if np.isfinite(value) else None
    return found


def rows_of(line: Case) -> list[Row]:
    """Errors before background and sky, and their ratio; stated sigmas, likewise."""
    one, two = line["background"], line["sky"]
    name = Path(line["case"]["config"]).stem
    doubtful = "-" if one["doubtful"] is None else f"{one['doubtful']:.0f} %"
    return [
        _row(name, "no mask", one["errors"], [doubtful, _pairs(one)]),
        _row("", "dark sky", two["errors"], ["-", _pairs(two)]),
        _row("", "factor", factors(line, "errors"), ["", ""], ratio=True),
        _row("", "sigma, no mask", one["sigma"], ["", ""]),
        _row("", "sigma, dark sky", two["sigma"], ["", ""]),
        _row("", "factor of sigmas", factors(line, "sigma"), ["", ""], ratio=True),
    ]


def factors(line: Case, kind: str) -> dict[str, float | None]:
    """Of each figure, that before the background over that before the sky; None: one is not determined."""
    one, two = line["background"][kind], line["sky"][kind]
    return {
        key: one[key] / two[key] if one.get(key) is not None and two.get(key) else None for key in FIGURES
    }


def _row(name: str, what: str, values: dict[str, Any], last: list[str], ratio: bool = False) -> Row:
    words = []
    for key in FIGURES:
        value = values.get(key)
        words.append("-" if value is None else f"{value:.{2 if ratio else DIGITS[key]}f}")
    return [name, what, *words, *last]


def _pairs(figures: dict[str, Any]) -> str:
    return f"{figures['pairs'][0]} of {figures['pairs'][1]}"


def verdict(lines: list[Case]) -> str:
    """How many of the figures are within the factor, and which are not."""
    found = [
        (Path(line["case"]["config"]).stem, key, value)
        for line in lines
        for key, value in factors(line, "errors").items()
        if value is not None
    ]
    above = [f"{name} {key} {value:.2f}" for name, key, value in found if value > MAX_FACTOR]
    words = f"Within a factor {MAX_FACTOR}: {len(found) - len(above)} of {len(found)} errors"
    return f"{words}; above: {', '.join(above)}." if above else f"{words}."


if __name__ == "__main__":
    command(main)
