"""Which features lead: errors of every scene, each front end of configs/studies/front_ends_of_scenes.yaml.

    python -m benchmarks.frontend.leading STUDY_FOLDER [--workers 1] [--short]

The study is swept in the folder, and goes on after whatever ended it. The first table has, for each scene,
the errors of the default against the truth, as docs/scenes.md, and for each other front end the ratios of its
errors to them: position, velocity, rate, attitude; then a verdict that is not ok, and the pairs that were
used, where they are fewer. The second has the geometric means of these ratios over the scenes in which both
have an error, and in how many scenes no error is larger by more than a tenth. The short form prints what is
stored.
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
    others = [name for name in dict.fromkeys(table[FEATURES]) if name != BASE]
    print_table(["scene", *ERRORS, *others], rows_of_scenes(table, others))
    print()
    names = ["features", "scenes", *(f"ratio, {name.split(' [')[0]}" for name in ERRORS), "all", "none worse"]
    print_table(names, rows_of_features(table), right_from=1)


def errors_of(row: "pd.Series[float]") -> Array:
    """(4,) errors of a run; NaN where it gives none."""
    return np.array([factor * float(row.get(name, np.nan)) for name, factor in ERRORS.values()])


def by_scene(table: pd.DataFrame) -> dict[tuple[str, str], "pd.Series[float]"]:
    """Rows by scene and front end."""
    return {(str(row[SCENE]), str(row[FEATURES])): row for _, row in table.iterrows()}


def rows_of_scenes(table: pd.DataFrame, others: Sequence[str]) -> Iterator[list[str]]:
    """Cells of the first table."""
    rows = by_scene(table)
    for scene in dict.fromkeys(name for name, _ in rows):
        if (scene, BASE) not in rows:
            continue
        base = errors_of(rows[scene, BASE])
        cells = [f"{error:.{digits}f}" for error, digits in zip(base, DIGITS, strict=True)]
        ratios = [_cell(rows.get((scene, name)), base) for name in others]
        yield [f"{scene}{_remarks(rows[scene, BASE])}", *cells, *ratios]


def _cell(row: "pd.Series[float] | None", base: Array) -> str:
    """Ratios of a front end's errors to the default's."""
    if row is None:
        return "-"
    ratios = errors_of(row) / base
    told = ", ".join(f"{each:.2f}" for each in ratios) if np.isfinite(ratios).all() else "none"
    return f"{told}{_remarks(row)}"


def _remarks(row: "pd.Series[float]") -> str:
    """In brackets: a verdict that is not ok, and pairs that were not used."""
    verdict = row["status"] if pd.isna(row["verdict"]) else row["verdict"]
    used, of = row.get("run.frames_used", np.nan), row.get("run.frames", np.nan)
    remarks = [] if verdict == "ok" else [str(verdict)]
    remarks += [f"{used:.0f} of {of:.0f}"] if used < of else []
    return f" ({', '.join(remarks)})" if remarks else ""


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
