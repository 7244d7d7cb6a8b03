"""Optimizers side by side: the pages and tables of docs/compare.md.

    python -m benchmarks.compare [--short] [-o FOLDER] [--run RUN]

One comparison for each file of configs/compare, and one of a stored run when it is there (``--run``, made by
``python -m benchmarks.scenes``). What was measured before is read from FOLDER: an interrupted benchmark goes
on where it stopped. ``--short``: every solver once on a small problem. At the end of each, on which problems
the default of the back end is on the Pareto front of time against accuracy, and who beats it on the others.
"""

import argparse
from pathlib import Path

from pipeline.compare.comparison import compare
from pipeline.compare.dominance import standing_lines, standings
from pipeline.compare.profiles import front, growths, successes
from pipeline.compare.rows import Comparison
from pipeline.compare.table import print_tables
from pipeline.console import choose_progress
from pipeline.threads import limit_threads
from polhode.config import Config
from polhode.config.loader import load_config

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
LONG = ("profiles", "seeds", "growth")


def main() -> None:
    """Compare, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true", help="one small problem")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("runs/compare"), help="folder of the results"
    )
    parser.add_argument("--run", type=Path, default=Path("runs/ts38"), help="stored run to compare on")
    options = parser.parse_args()
    limit_threads(1)
    if not options.short and options.run.is_dir():
        _one(CONFIGS / "default.yaml", options.output / options.run.name, options.run)
    for name in ("short",) if options.short else LONG:
        _one(CONFIGS / "compare" / f"{name}.yaml", options.output / name, None)


def _one(config: Path, folder: Path, run: Path | None) -> None:
    values: Config = load_config(config, {})
    found = compare(values, folder, choose_progress(), run=run)
    print_tables(found)
    print_together(found, values.backend.solver)
    print(f"Page: {folder / 'compare.html'}\n", flush=True)


def print_together(found: Comparison, default: str) -> None:
    """What the rows say together: success, growth, the front."""
    if len({(row.problem, row.start, row.seed) for row in found.rows}) > 1:
        for solver, of_kind in successes(found).items():
            told = ", ".join(f"{kind} {done} of {tried}" for kind, (done, tried) in of_kind.items())
            print(f"  {solver}: solved {told}")
    for growth in growths(found):
        print(f"  {growth.solver}: time ~ unknowns^{growth.exponent:.2f}")
    for problem in found.problems:
        rows = [row for row in found.rows if row.problem == problem.name and row.start == "cold"]
        print(f"  {problem.name}: on the front: {', '.join(row.solver for row in front(rows))}")
    print("\n".join(standing_lines(standings(found, default), default)))


if __name__ == "__main__":
    main()
