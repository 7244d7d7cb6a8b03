"""Which features lead: errors of every scene, each front end of configs/studies/front_ends_of_scenes.yaml.

    python -m benchmarks.frontend.leading STUDY_FOLDER [--workers 1] [--short]

The study is swept in the folder, and goes on after whatever ended it. The first table has, for each scene and
front end, the errors against the truth, as docs/scenes.md, and their ratios to those of the first front end,
which is the default. The second has, for each front end, the geometric means of these ratios over the scenes
in which both have an error, and in how many scenes no error is larger by more than a tenth. The short form
prints what is stored.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
from tyro.conf import Positional, arg

import polhode as program
from benchmarks.command import ROOT, Short, Workers, command, polhode
from benchmarks.presentation import print_table
from polhode.lie import Array

STUDY = ROOT / "configs/studies/front_ends_of_scenes.yaml"
SCENE, FEATURES = "scene", "features"
BASE = "rootsift and patches"
"""The default."""
ERRORS: Mapping[str, tuple[str, float]] = {
    "position [mm]": ("evaluate.rmse_position_m", 1e3),
    "velocity [mm/s]": ("evaluate.rmse_velocity_m_s", 1e3),
    "w [deg/s]": ("evaluate.rmse_angular_velocity_deg_s", 1.0),
    "attitude [deg]": ("evaluate.attitude_error_deg.median", 1.0),
}
DIGITS = (3, 3, 4, 4)
WORSE = 1.1


def main(
    folder: Positional[Annotated[Path, arg(metavar="STUDY_FOLDER", help="Of the study.")]],
    short: Short = False,
    workers: Workers = 1,
) -> None:
    """Compute what is missing, and print both tables."""
    if not short:
        polhode("sweep", STUDY, "-o", folder, "--workers", workers, may_fail=True)
    table = program.load_study(str(folder))
    print_table(["scene", "features", *ERRORS, "ratios", "pairs", "seconds"], rows_of_scenes(table))
    print()
    names = ["features", "scenes", *(f"ratio, {name.split(' [')[0]}" for name in ERRORS), "all", "none worse"]
    print_table(names, rows_of_features(table), right_from=1)


def errors_of(row: "pd.Series[float]") -> Array:
    """(4,) errors of a run; NaN where it gives none."""
    return np.array([factor * float(row.get(name, np.nan)) for name, factor in ERRORS.values()])


def by_scene(table: pd.DataFrame) -> dict[tuple[str, str], "pd.Series[float]"]:
    """Rows by scene and front end."""
    return {(str(row[SCENE]), str(row[FEATURES])): row for _, row in table.iterrows()}


def rows_of_scenes(table: pd.DataFrame) -> Iterator[list[str]]:
    """Cells of the first table."""
    rows = by_scene(table)
    for (scene, features), row in rows.items():
        errors, base = errors_of(row), rows.get((scene, BASE))
        cells = [f"{error:.{digits}f}" for error, digits in zip(errors, DIGITS, strict=True)]
        ratios = "-" if base is None or features == BASE else _ratios(errors / errors_of(base))
        verdict = row["status"] if pd.isna(row["verdict"]) else row["verdict"]
        pairs = f"{row.get('run.frames_used', np.nan):.0f} of {row.get('run.frames', np.nan):.0f}"
        named = scene if verdict == "ok" else f"{scene} ({verdict})"
        yield [named, features, *cells, ratios, pairs, f"{row.get('time.run_s', np.nan):.0f}"]


def _ratios(ratios: Array) -> str:
    return ", ".join(f"{each:.2f}" for each in ratios)


def rows_of_features(table: pd.DataFrame) -> Iterator[list[str]]:
    """Cells of the second table."""
    rows = by_scene(table)
    for features in dict.fromkeys(name for _, name in rows):
        ratios = ratios_of(rows, features)
        if features != BASE and len(ratios):
            means = np.exp(np.log(ratios).mean(axis=0))
            whole = float(np.exp(np.log(ratios).mean()))
            none_worse = int((ratios <= WORSE).all(axis=1).sum())
            numbers = (f"{each:.2f}" for each in (*means, whole))
            yield [features, str(len(ratios)), *numbers, f"{none_worse} of {len(ratios)}"]


def ratios_of(rows: Mapping[tuple[str, str], "pd.Series[float]"], features: str) -> Array:
    """(n, 4) errors over those of the default, of the scenes in which both have all errors."""
    found: Sequence[Array] = [
        errors_of(row) / errors_of(rows[scene, BASE])
        for (scene, name), row in rows.items()
        if name == features and (scene, BASE) in rows
    ]
    known = [each for each in found if np.isfinite(each).all()]
    return np.array(known).reshape(-1, len(ERRORS))


if __name__ == "__main__":
    command(main)
