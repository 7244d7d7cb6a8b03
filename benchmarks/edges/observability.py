"""What the observability metric foretells against what an edge tracker does: Monte Carlo on rendered images.

python -m benchmarks.edges.observability [--short] [--workers 1] [--record FILE] [--stored]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.edges.edge_bodies import NAMES
from benchmarks.edges.edge_solids import SOLIDS
from benchmarks.edges.observability_cases import measure
from benchmarks.edges.observability_tables import (
    Spot,
    good_and_bad_table,
    nees_table,
    plot,
    spots_of,
    trend_table,
    wrong_table,
)
from benchmarks.record import Case, complete, measured

RECORD = Path("runs/observability.jsonl")


PLAIN = (*(name for name in SOLIDS if name != "satellite"), "free_flyer")
"""Bodies whose edges stand clear of each other"""
CLUTTERED = tuple(name for name in NAMES if name not in PLAIN)
"""Bodies with thin panels, bars, bevels and many small parts"""
FIXED_M = 3.0


def cases(short: bool) -> list[Case]:
    """Every measurement, the most wanted first."""
    count = {"poses": 4, "each": 3} if short else {"poses": 20, "each": 10}
    fixed = {"poses": 3, "each": 3} if short else {"poses": 10, "each": 10}
    plain = PLAIN[:2] if short else PLAIN
    cluttered = () if short else CLUTTERED
    near = {"near_m": 2.0, "far_m": 4.0, "rich": False}
    at = {"near_m": FIXED_M, "far_m": FIXED_M, "rich": False}
    wrong = {"poses": 2 if short else 5, "each": 1, **near, "seed": 5}
    out: list[Case] = [
        {"part": "approach", "body": body, "poses": 9, **near, "each": fixed["each"], "seed": 9}
        for body in ("satellite", "steps")
    ]
    out += [{"part": "trend", "body": body, **near, **count, "seed": 1} for body in plain]
    out += [{"part": "fixed", "body": body, **at, **fixed, "seed": 2} for body in plain]
    out += [{"part": "wrong", "body": body, **wrong} for body in (*plain, *cluttered)]
    out += [{"part": "trend", "body": body, **near, **count, "seed": 1} for body in cluttered]
    return out


def main() -> None:
    """Measure what the record lacks; print the tables; draw the trends."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true", help="two bodies, few poses")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--record", type=Path, default=RECORD)
    parser.add_argument("--stored", action="store_true", help="only what was measured before")
    parser.add_argument("-o", "--output", type=Path, help="the picture")
    options = parser.parse_args()
    wanted = cases(options.short)
    if options.stored:
        lines = measured(options.record, wanted)
    else:
        lines = complete(options.record, wanted, measure, options.workers)
    groups = {
        "three models of steps, 4 to 2 m": _spots(lines, "approach", ["steps"]),
        "three models of satellite, 4 to 2 m": _spots(lines, "approach", ["satellite"]),
        "plain bodies, 2 to 4 m": _spots(lines, "trend", PLAIN),
        f"plain bodies, {FIXED_M:g} m": _spots(lines, "fixed", PLAIN),
        "cluttered bodies, 2 to 4 m": _spots(lines, "trend", CLUTTERED),
        "all bodies, 2 to 4 m": _spots(lines, "trend", NAMES),
    }
    groups = {name: spots for name, spots in groups.items() if spots}
    print("# Trends\n\n" + trend_table(groups))
    plain = _spots(lines, "trend", PLAIN)
    if len({spot.body for spot in plain}) > 1:
        print("\n# What is good and what is bad\n\n" + good_and_bad_table(plain))
        for first, title in ((True, "one trial of each pose"), (False, "all trials")):
            table, found, before = nees_table(plain, first)
            print(f"\n# Honesty of covariances, {title}\n\n{table}")
        print(f"\nLEVELS = {found}\nFORETOLD = {before}")
    wrong = [line for line in lines if line["case"]["part"] == "wrong"]
    if len(wrong) > 1:
        print("\n# Right and wrong poses\n\n" + wrong_table(wrong))
    if options.output:
        plot(groups, options.output)


def _spots(lines: list[Case], part: str, bodies: Sequence[str]) -> list[Spot]:
    return spots_of(
        [line for line in lines if line["case"]["part"] == part and line["case"]["body"] in bodies]
    )


if __name__ == "__main__":
    main()
