"""Findings on optimizers: which of them reach the least cost, from which start, in how much time."""

import re

import numpy as np
import pandas as pd

from benchmarks.studies.confidence import finite, geometric_mean, median, share_text
from benchmarks.studies.study_results import Part, Results

SAME_COST = 1e-6
"""Relative: a solution is one of the least cost that is known"""
WITHIN = (1.0, 2.0, 5.0, 10.0)
"""Times of the fastest, of a performance profile"""
STATUS = re.compile(r"compare\.(?P<problem>[^.]+)\.(?P<solver>[^.]+)\.(?P<start>[^.]+)\.status")
ERRORS = {
    "attitude": "attitude_deg",
    "rate": "angular_velocity_deg_s",
    "centre of mass": "com_mm",
    "k1": "k1",
    "k2": "k2",
}
CLAIMED = "ok"
"""Status of a solver that claims convergence"""
BASELINE = "baseline"
ABBREVIATED = {"cold0": "cold", "perturbed0": "disturbed", "near0": "near"}


def cases_of(results: Results) -> pd.DataFrame:
    """A row for each solver, problem and start, with the least cost that any solver found on the problem."""
    frame = results.table.to_pandas()
    rows = []
    for column in frame.columns:
        match = STATUS.fullmatch(column)
        if match is None:
            continue
        stem = column.removesuffix("status")
        for k in np.flatnonzero(frame[column].notna()):
            row = frame.iloc[k]
            rows.append(
                {
                    "point": int(row["point"]),
                    "solver": match["solver"],
                    "start": ABBREVIATED.get(match["start"], match["start"]),
                    "status": str(row[column]),
                    "cost": _number(row, f"{stem}cost"),
                    "iterations": _number(row, f"{stem}iterations"),
                    "seconds": _number(row, f"time.{stem}wall_s"),
                    **{name: abs(_number(row, f"{stem}errors.{key}")) for name, key in ERRORS.items()},
                }
            )
    found = pd.DataFrame(rows)
    found["least"] = found.groupby("point")["cost"].transform("min")
    found["over"] = found["cost"] / found["least"] - 1.0
    found["solved"] = (found["status"] == CLAIMED) & (found["over"] <= SAME_COST)
    return found


def _number(row: "pd.Series[float]", name: str) -> float:
    value = row.get(name)
    return float("nan") if value is None else float(value)


def optimizers_over_bodies(results: Results) -> list[Part]:
    """Which solver is the fastest, and which can be trusted?"""
    cases = cases_of(results)
    rivals = cases[~cases["solver"].isin(cases[cases["status"] == BASELINE]["solver"].unique())]
    return [_solved(rivals), _profile(rivals), _wrong_claims(rivals), _errors_of_baselines(cases)]


def _starts(cases: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys(cases["start"]))


def _solved(cases: pd.DataFrame) -> Part:
    """Cases in which a solver claims convergence, and has the least cost."""
    rows = []
    for solver, own in cases.groupby("solver", sort=False):
        cells = []
        for start in _starts(cases):
            at = own[own["start"] == start]
            solved = at[at["solved"]]
            cells += [
                share_text(int(at["solved"].sum()), len(at)),
                median(solved["iterations"].to_numpy(float)).text(),
            ]
        rows.append([solver, *cells])
    starts = " | ".join(f"{start}: solved | iterations" for start in _starts(cases))
    return Part("Solved: convergence is claimed at the least known cost", f"solver | {starts}", rows)


def _profile(cases: pd.DataFrame) -> Part:
    """Performance profile: the share of all cases that a solver solves within a multiple of the fastest."""
    solved = cases[cases["solved"]]
    fastest = solved.groupby(["point", "start"])["seconds"].min().rename("fastest")
    joined = cases.join(fastest, on=["point", "start"])
    within = np.where(joined["solved"], joined["seconds"] / joined["fastest"], np.inf)
    rows = []
    for solver, at in joined.groupby("solver", sort=False).indices.items():
        own = within[at]
        cells = [share_text(int((own <= times).sum()), len(own)) for times in WITHIN]
        rows.append([solver, *cells, geometric_mean(own[np.isfinite(own)]).text()])
    columns = " | ".join(f"within {times:g}x" for times in WITHIN)
    return Part("Time over that of the fastest", f"solver | {columns} | mean ratio where solved", rows)


def _wrong_claims(cases: pd.DataFrame) -> Part:
    """Convergence that is claimed above the least known cost."""
    rows = []
    for (solver, start), own in cases.groupby(["solver", "start"], sort=False):
        claimed = own[own["status"] == CLAIMED]
        wrong = claimed[~claimed["solved"]]
        if len(wrong):
            above = wrong["over"].to_numpy(float)
            rows.append(
                [
                    solver,
                    start,
                    share_text(len(wrong), len(claimed)),
                    f"{above.min():.1%} to {above.max():.1%}",
                ]
            )
    return Part("Convergence claimed above the least cost", "solver | start | claims | cost above", rows, 2)


def _errors_of_baselines(cases: pd.DataFrame) -> Part:
    """Errors of baselines over those of the solution of least cost."""
    solved = cases[cases["solved"]].drop_duplicates("point").set_index("point")
    rows = []
    for (solver, start), own in cases[cases["status"] == BASELINE].groupby(["solver", "start"], sort=False):
        known = own[own["point"].isin(solved.index)]
        cells = []
        for name in ERRORS:
            ratio = known[name].to_numpy(float) / solved.loc[known["point"], name].to_numpy(float)
            cells.append(geometric_mean(finite(ratio[ratio > 0.0])).text())
        rows.append([solver, start, len(known), *cells])
    columns = f"baseline | start | cases | {' | '.join(ERRORS)}"
    return Part("Errors of baselines over those of the least cost", columns, rows, 2)
