"""The missions flown and judged: consistency of the sigmas, verdicts, power of the checks, predictions.

    python -m lab.missions.missions [--first 0] [--last 320] [--half chosen] [--workers 1] [--table] [--short]

Each mission is simulated, run with configs/default.yaml and judged by its truth, and is a row of the record;
an interrupted benchmark goes on, and sequences and runs that are there are used again. ``--half``: only
bodies by which limits were chosen, or only those held back. Tables: outcomes by half and by kind of mission;
consistency (squared errors over their expectation, with the 95 % band; share within three sigma);
predictions; for each check how many wrong missions it finds, finds alone, and doubts without cause.
docs/trust.md explains them.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import arg

from lab.command import LIGHT, RECORDS, ROOT, Record, Short, Workers, command
from lab.missions.consistency import QUANTITIES, holds, pooled
from lab.missions.draw import MISSIONS, TUNED_DRAW, Mission, mission
from lab.missions.judgement import judgement
from lab.missions.predictions import AHEAD_S, PARTS
from lab.presentation import print_table
from lab.record import Case, complete, measured
from lab.robustness.judge import OUTCOMES, outcome_of
from polhode.config.loader import load_config
from polhode.pipeline.run import run
from polhode.run_directory.check_table import CHECK_TABLE
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.sequence import plan_sequence, write_sequence

RECORD = RECORDS / "missions"
Half = Literal["all", "chosen", "held back"]
MESH = ("within_1_sigma", "within_3_sigma")
SETTINGS = {"outputs": ("motion", "surface"), "runtime.workers": 1}
"""No pictures, which no judgement needs"""
INCOMPLETE = "right, data incomplete"
"""A right run that is doubted because most pairs are lost, or the data leave the rotation open"""


def main(
    first: Annotated[int, arg(help="Number of the first mission.")] = 0,
    last: Annotated[int, arg(help="The one before which to stop.")] = MISSIONS,
    half: Annotated[Half, arg(help="Which bodies.")] = "all",
    draw: Annotated[int, arg(help="Draw; others than the first have not been looked at.")] = TUNED_DRAW,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
    folder: Annotated[Path, arg(help="Where sequences and runs are kept.")] = ROOT / "runs/missions",
    table: Annotated[bool, arg(help="Only print the tables of what the record has.")] = False,
) -> None:
    """Measure what the record lacks, print the tables."""
    numbers = range(1, 2) if short else range(first, last)
    cases = [case for n in numbers if half in ("all", (case := _case(n, draw))["half"])]
    lines = measured(record, cases) if table else complete(record, cases, Measure(folder, short), workers)
    print_outcomes(lines)
    print_consistency(lines)
    print_predictions(lines)
    print_predictions([line for line in lines if not wrongs(line)])
    print_checks(lines)


def _case(number: int, draw: int) -> Case:
    flown = mission(number, draw)
    half: Half = "held back" if flown.is_held_back else "chosen"
    return {"number": number, "draw": draw, "half": half, **flown.kinds}


@dataclass(frozen=True)
class Measure:
    """One mission, judged."""

    folder: Path
    short: bool = False

    def __call__(self, case: Case) -> Case:
        """The row of a case."""
        flown = mission(case["number"], case["draw"])
        place = self.folder / str(case["draw"]) / f"{flown.number:03d}"
        if not self.short:
            return fly(flown, place)
        return fly(flown.beginning(8), self.folder / "short", LIGHT)


def fly(flown: Mission, folder: Path, settings: dict[str, Any] | None = None) -> dict[str, Any]:
    """The row of a mission; its sequence and run remain in ``folder`` and are used again.

    settings: beside those of the default configuration.
    """
    sequence, out = sequence_and_run(flown, folder, settings)
    return judgement(out, sequence, flown.scene.body.size_m)


def sequence_and_run(
    flown: Mission, folder: Path, settings: dict[str, Any] | None = None
) -> tuple[Path, Path]:
    """Folders of a mission in ``folder``, made unless they are there; settings as ``fly`` takes them."""
    sequence, out = folder / "sequence", folder / "run"
    if not (sequence / "mav0").is_dir():
        write_sequence(plan_sequence(flown.scene, flown.seed), sequence, Silent())
    if not (out / "summary.json").is_file():
        # summary.json says why it failed
        with suppress(RunFailure):
            run(load_config(None, SETTINGS | (settings or {})), sequence, out, Silent())
    return sequence, out


def print_outcomes(lines: Sequence[Case]) -> None:
    """Outcomes of each half and of each kind; then the missions that are wrong, or right and doubted."""
    rows = []
    for name in ("half", "family", "motion", "light", "rig", "inspector"):
        for value in dict.fromkeys(line["case"][name] for line in lines):
            some = [outcome(line) for line in lines if line["case"][name] == value]
            counts = (some.count(each) or "" for each in (*OUTCOMES, INCOMPLETE))
            rows.append([f"{name} {value}", len(some), *counts])
    print_table(("missions", "number", *OUTCOMES, INCOMPLETE), rows, right_from=1)
    print()
    doubtful = [line for line in lines if outcome(line) != "right"]
    print_table(
        ("mission", "outcome", "wrong", "checks that do not hold"),
        (
            (
                line["case"]["number"],
                outcome(line),
                ", ".join(wrongs(line)) or "-",
                "; ".join(doubts(line)) or "-",
            )
            for line in doubtful
        ),
    )


def wrongs(line: Case) -> list[str]:
    """What is wrong in a mission, predictions included."""
    ahead = ["prediction"] if line.get("predictions", {}).get("wrong") else []
    return [*line["wrong"], *ahead]


def doubts(line: Case) -> list[str]:
    """Names of the checks that do not hold."""
    return [name for name, (_, _, beyond) in line["checks"].items() if beyond]


def outcome(line: Case) -> str:
    """One of OUTCOMES, or INCOMPLETE."""
    found = outcome_of(line | {"wrong": wrongs(line), "warnings": []})
    is_incomplete = {CHECK_TABLE[key].name for key in ("frames", "rotation")} & {*doubts(line)}
    return INCOMPLETE if found == OUTCOMES[3] and is_incomplete else found


def print_consistency(lines: Sequence[Case]) -> None:
    """Squared errors over their expectation, pooled: all, by half, without those that are wrong; medians."""
    rows = []
    for title in ("all", "chosen", "held back", "not wrong"):
        some = [line for line in lines if title in ("all", line["case"]["half"], wrongs(line) or "not wrong")]
        if some:
            rows.append([title, *(_pooled_cell(some, quantity) for quantity in QUANTITIES)])
    rows.append(["the median one", *(_median_cell(lines, quantity) for quantity in QUANTITIES)])
    print("\nmean squared error over its expectation in its band (within three sigma [%])\n")
    print_table(("missions", *QUANTITIES), rows, right_from=1)
    inside = [each["inside"] for line in lines for each in line.get("intervals", {}).values()]
    shares = [[line["mesh"][key] for line in lines if line.get("mesh")] for key in MESH]
    within = " and ".join(f"{100.0 * np.median(share):.1f}" for share in shares if share)
    print(
        f"\nintervals with the truth: {sum(inside)} of {len(inside)}; of the vertices of the median mesh",
        end=" ",
    )
    print(f"{within} % are within one and three of their sigmas")


def _pooled_cell(lines: Iterable[Case], quantity: str) -> str:
    """Ratio, its band, coverage; in bold where they do not hold."""
    result = pooled([
        line["consistency"][quantity] for line in lines if quantity in line.get("consistency", {})
    ])  # fmt: skip
    if result["ratio"] is None:
        return "-"
    text = (
        f"{result['ratio']:.2f} in {result['low']:.2f} to {result['high']:.2f} "
        f"({100.0 * result['coverage']:.1f})"
    )
    return text if holds(result) else f"**{text}**"


def _median_cell(lines: Iterable[Case], quantity: str) -> str:
    """Of the ratios of the missions that claim it, and how many have more than 3."""
    entries = [line["consistency"][quantity] for line in lines if quantity in line.get("consistency", {})]
    ratios = np.array([each["nees"] / each["expected"] for each in entries])
    return f"{np.median(ratios):.2f} (above 3: {np.sum(ratios > 3.0)} of {len(ratios)})" if entries else "-"


def print_predictions(lines: Sequence[Case]) -> None:
    """Share inside the regions of 99 %, and for each component the sigma over the error, root mean square."""
    found = [line["predictions"]["ahead"] for line in lines if "predictions" in line]
    if not found:
        return
    rows = []
    for ahead_s in (f"{each:g}" for each in AHEAD_S):
        error, sigma = (np.array([each[ahead_s][key] for each in found]) for key in ("error", "sigma"))
        # of a ratio of sums the largest would decide; each mission counts alike
        ratio = 1.0 / np.sqrt(np.mean((error / sigma) ** 2, axis=0))
        inside = 100.0 * np.mean([each[ahead_s]["inside"] for each in found], axis=0)
        parts = (" ".join(f"{x:.2f}" for x in ratio[3 * n : 3 * n + 3]) for n in range(len(PARTS)))
        rows.append([ahead_s, " ".join(f"{x:.0f}" for x in inside), *parts])
    print(f"\n{len(found)} predictions: inside the regions of 99 % [%], sigma over error by component\n")
    print_table(("seconds ahead", "inside", *PARTS), rows, right_from=1)


def print_checks(lines: Sequence[Case]) -> None:
    """For each check that raises anything: wrong missions found, found by no other, right ones doubted."""
    found, alone, doubted = Counter[str](), Counter[str](), Counter[str]()
    for line in lines:
        names = doubts(line)
        if wrongs(line):
            found.update(names)
            alone.update(names[:1] if len(names) == 1 else [])
        else:
            doubted.update(names)
    rows = [(name, found[name], alone[name], doubted[name]) for name in sorted({*found, *doubted})]
    print()
    print_table(
        ("check", "wrong missions found", "found alone", "right missions doubted"), rows, right_from=1
    )
    checks, seconds = (sum(line[key] for line in lines) for key in ("checks_seconds", "seconds"))
    print(f"\nChecks: {100.0 * checks / max(seconds, 1e-9):.1f} % of the time of the runs")


if __name__ == "__main__":
    command(main)
