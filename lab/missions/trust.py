"""Whether runs can be trusted: sigmas, coverage, verdicts, intervals, mesh and the time of the checks.

    python -m lab.missions.trust [--groups configs new] [--names ...] [--table] [--short]

Groups: the scenes of configs/ (with configs/ts38.yaml); new ones, which nothing was tuned on. Each scene is
simulated, run with configs/default.yaml and judged, and is a row of the record; an interrupted benchmark goes
on. Tables: consistency of each scene and pooled (squared errors over their expectation, with the 95 % band;
share within three sigma); verdicts, with the mesh and the cost of the checks. docs/trust.md explains them.
"""

import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

from lab.command import LIGHT, RECORDS, ROOT, Record, Short, Workers, command
from lab.presentation import print_table
from lab.record import Case, complete, measured
from lab.robustness.judge import OUTCOMES, outcome_of
from lab.missions.consistency import QUANTITIES, holds, pooled
from lab.missions.judgement import judgement
from lab.missions.new_scenes import KINDS, new_scene
from polhode.config.loader import load_config
from polhode.pipeline.run import run
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.sequence import plan_sequence, write_sequence

RECORD = RECORDS / "trust"
Group = Literal["configs", "new"]
CONFIGS = {
    path.stem: path for path in (ROOT / "configs/ts38.yaml", *sorted(ROOT.glob("configs/scenes/*.yaml")))
}
GROUPS: dict[str, tuple[str, ...]] = {"configs": tuple(CONFIGS), "new": tuple(KINDS)}
"""Names of each group; those of "new" exist in any number of draws."""
SHORT = {"configs": ("pure_spin",), "new": ()}


def main(
    groups: Annotated[tuple[Group, ...], arg(help="Groups of scenes.")] = ("configs", "new"),
    names: Annotated[tuple[str, ...], arg(help="Only these of them.")] = (),
    draw: Annotated[int, arg(help="Which draw of the new scenes.")] = 1,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
    folder: Annotated[Path, arg(help="Where sequences and runs are kept.")] = ROOT / "runs/trust",
    keep: Annotated[bool, arg(help="Keep sequences and runs, some 50 MB each.")] = False,
    table: Annotated[bool, arg(help="Only print the tables of what the record has.")] = False,
) -> None:
    """Measure what the record lacks, print the tables."""
    known = {name for group in groups for name in GROUPS[group]}
    for name in names:
        if name not in known:
            raise SystemExit(f"{name}: there are only {', '.join(sorted(known))}")
    cases: list[Case] = [
        {"group": group, "name": name, **({"draw": draw} if group == "new" else {})}
        for group in groups
        for name in (SHORT if short else GROUPS)[group]
        if not names or name in names
    ]
    measure = Measure(folder, keep, short)
    lines = measured(record, cases) if table else complete(record, cases, measure, workers)
    print_consistency(lines)
    print_verdicts(lines)


@dataclass(frozen=True)
class Measure:
    """One scene, judged."""

    folder: Path
    keep: bool
    short: bool = False

    def __call__(self, case: Case) -> Case:
        """The row of a case; a sequence or run that an interrupted one left is used."""
        group, name, draw = case["group"], case["name"], case.get("draw", 1)
        place = self.folder / group / (f"{name}_{draw}" if group == "new" else name)
        if group == "new":
            scene, seed = new_scene(name, draw)
        else:
            config = load_config(CONFIGS[name])
            assert config.scene is not None
            scene, seed = config.scene, config.seed
        settings: dict[str, Any] = {"runtime.workers": 1}
        if self.short:
            settings |= LIGHT
            scene = scene.model_copy(update={"frames": 8})
        sequence, out = place / "sequence", place / "run"
        if not (sequence / "mav0").is_dir():
            write_sequence(plan_sequence(scene, seed), sequence, Silent())
        if not (out / "summary.json").is_file():
            shutil.rmtree(out, ignore_errors=True)
            # summary.json says why it failed
            with suppress(RunFailure):
                run(load_config(None, settings), sequence, out, Silent())
        row = judgement(out, sequence)
        if not self.keep:
            shutil.rmtree(place)
        return row


def print_consistency(lines: Sequence[Case]) -> None:
    """Squared errors over their expectation by scene, then pooled: all, of configs/, new ones."""
    print(f"\n{len(lines)} scenes: mean squared error over its expectation (within three sigma [%])\n")
    rows = [[name_of(line), *(_share(line, quantity) for quantity in QUANTITIES)] for line in lines]
    by_group = {
        "all": lines,
        **{g: [line for line in lines if line["case"]["group"] == g] for g in ("configs", "new")},
    }
    for title, some in by_group.items():
        if some and (title == "all" or len(some) < len(lines)):
            rows.append([f"**{title}**", *(_pooled_cell(some, quantity) for quantity in QUANTITIES)])
    print_table(("scene", *QUANTITIES), rows, right_from=1)


def name_of(line: Case) -> str:
    """Of a scene; a new one with its draw."""
    case = line["case"]
    return f"{case['name']} {case['draw']}" if "draw" in case else str(case["name"])


def _share(line: Case, quantity: str) -> str:
    entry = line.get("consistency", {}).get(quantity)
    if entry is None:
        return "-"
    return f"{entry['nees'] / entry['expected']:.2f} ({100.0 * entry['inside'] / entry['total']:.0f})"


def _pooled_cell(lines: Sequence[Case], quantity: str) -> str:
    """Ratio, its band, coverage; in bold where they do not hold."""
    found = [line["consistency"][quantity] for line in lines if quantity in line.get("consistency", {})]
    result = pooled(found)
    if result["ratio"] is None:
        return "-"
    text = (
        f"{result['ratio']:.2f} in {result['low']:.2f} to {result['high']:.2f} "
        f"({100.0 * result['coverage']:.1f})"
    )
    return text if holds(result) else f"**{text}**"


def print_verdicts(lines: Sequence[Case]) -> None:
    """What each run says, whether it is wrong, its intervals, its mesh and what its checks cost."""
    print()
    rows = []
    for line in lines:
        inside = [entry["inside"] for entry in line.get("intervals", {}).values()]
        cost = line.get("checks_seconds")
        doubts = [name for name, (_, _, beyond) in line["checks"].items() if beyond]
        rows.append([
            name_of(line), line["status"], "; ".join(doubts) or "-", ", ".join(line["wrong"]) or "-",
            f"{sum(inside)} of {len(inside)}" if inside else "-", *_mesh_cells(line.get("mesh") or {}),
            f"{line['seconds']:.0f}", "-" if cost is None else f"{100.0 * cost / line['seconds']:.1f}",
        ])  # fmt: skip
    head = ("scene", "status", "checks that do not hold", "wrong", "intervals with the truth",
            "mesh within 1 sigma [%]", "within 3", "seconds", "of these checks [%]")  # fmt: skip
    print_table(head, rows, right_from=4)
    outcomes = [outcome_of(line) for line in lines]
    print("\n" + ", ".join(f"{outcomes.count(name)} {name}" for name in OUTCOMES))
    timed = [line for line in lines if line["checks_seconds"]]
    if timed:
        seconds, checks = (sum(line[key] for line in timed) for key in ("seconds", "checks_seconds"))
        print(f"Checks: {100.0 * checks / seconds:.1f} % of the time of {len(timed)} runs")


def _mesh_cells(mesh: dict[str, Any]) -> list[str]:
    keys = ("within_1_sigma", "within_3_sigma")
    return ["-" if mesh.get(key) is None else f"{100.0 * mesh[key]:.1f}" for key in keys]


if __name__ == "__main__":
    command(main)
