"""What the observability metric foretells against what an edge tracker does: Monte Carlo on rendered images.

python -m benchmarks.observability [--short] [--workers 1] [--record FILE] [--stored]
"""

import argparse
from pathlib import Path

from benchmarks.edge_bodies import NAMES
from benchmarks.edge_solids import SOLIDS
from benchmarks.observability_cases import measure
from benchmarks.record import Case, complete, measured

RECORD = Path("runs/observability.jsonl")


PLAIN = (*SOLIDS, "free_flyer")
"""Bodies whose edges stand clear of each other"""
CLUTTERED = tuple(name for name in NAMES if name not in PLAIN)
"""Bodies with many small parts, bevels and thin panels"""
FIXED_M = 3.0


def cases(short: bool) -> list[Case]:
    """Every measurement, the most wanted first."""
    count = {"poses": 4, "each": 3} if short else {"poses": 20, "each": 6}
    fixed = {"poses": 3, "each": 3} if short else {"poses": 10, "each": 6}
    plain = PLAIN[:2] if short else PLAIN
    cluttered = () if short else CLUTTERED
    near = {"near_m": 2.0, "far_m": 4.0, "rich": False}
    at = {"near_m": FIXED_M, "far_m": FIXED_M, "rich": False}
    wrong = {"poses": 2 if short else 5, "each": 1, **near, "seed": 5}
    out: list[Case] = [
        {"part": "approach", "body": "satellite", "poses": 9, **near, "each": fixed["each"], "seed": 9}
    ]
    out += [{"part": "trend", "body": body, **near, **count, "seed": 1} for body in plain]
    out += [{"part": "wrong", "body": body, **wrong} for body in (*plain, *cluttered)]
    out += [{"part": "fixed", "body": body, **at, **fixed, "seed": 2} for body in plain]
    out += [{"part": "trend", "body": body, **near, **count, "seed": 1} for body in cluttered]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--record", type=Path, default=RECORD)
    parser.add_argument("--stored", action="store_true")
    options = parser.parse_args()
    wanted = cases(options.short)
    lines = (
        measured(options.record, wanted)
        if options.stored
        else complete(options.record, wanted, measure, options.workers)
    )
    print(len(lines))


if __name__ == "__main__":
    main()
