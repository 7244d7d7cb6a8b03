"""What the observability metric foretells against what an edge tracker does: Monte Carlo on rendered images.

python -m benchmarks.observability [--short] [--workers 1] [--record FILE] [--stored]
"""

import argparse
from pathlib import Path

from benchmarks.edge_bodies import NAMES
from benchmarks.observability_cases import measure
from benchmarks.record import Case, complete, measured

RECORD = Path("runs/observability.jsonl")


def cases(short: bool) -> list[Case]:
    bodies = ("wedge", "satellite") if short else NAMES
    few = {"poses": 4, "each": 4} if short else {"poses": 20, "each": 12}
    any_range = {"near_m": 2.0, "far_m": 4.0, "seed": 1}
    out: list[Case] = [{"part": "trend", "body": b, "rich": False, **few, **any_range} for b in bodies]
    wrong = {"poses": 2 if short else 8, "each": 1}
    out += [{"part": "wrong", "body": b, "rich": False, **wrong, **any_range, "seed": 5} for b in bodies]
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
