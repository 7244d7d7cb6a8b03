"""Optimizers side by side: the pages and tables of docs/compare.md.

    python -m benchmarks.solvers.compare [NAME ...] [--short] [-o FOLDER] [--run RUN] [--sequence SEQ]
                                        [--stored]

A NAME is that of a file of configs/compare, or ``run``: configs/default.yaml on a stored run (made by
``python -m benchmarks.end_to_end.scenes``), with the truth of its sequence when that is there. Without a
name: ``run``, profiles, seeds, growth and ablations. Pages go to FOLDER/NAME; what was measured before is
read from there, so that an interrupted benchmark goes on where it stopped. ``--stored``: nothing is measured,
the tables of what FOLDER holds are printed. ``--short``: every solver once on a small problem.
"""

import argparse
from pathlib import Path

from benchmarks.solvers.compare_tables import markdown
from polhode.cli.console import choose_progress
from polhode.compare.comparison import FILE, compare
from polhode.compare.tables.rows import read_comparison
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.threads import limit_threads

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
LONG = ("run", "profiles", "seeds", "growth", "ablations")


def main() -> None:
    """Compare, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", choices=["short", *LONG, []], help="which comparisons")
    parser.add_argument("--short", action="store_true", help="one small problem")
    parser.add_argument("--stored", action="store_true", help="print what is there")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("runs/compare"), help="folder of the results"
    )
    parser.add_argument("--run", type=Path, default=Path("runs/ts38"), help="stored run to compare on")
    parser.add_argument(
        "--sequence", type=Path, default=Path("data/ts38"), help="sequence of that run, for its truth"
    )
    options = parser.parse_args()
    limit_threads(1)
    for name in ("short",) if options.short else options.names or LONG:
        folder = options.output / name
        if options.stored and not (folder / FILE).is_file():
            print(f"{name}: nothing stored in {folder}\n")
            continue
        print(
            f"## {name}\n\n{tables(name, folder, options)}\n\nPage: {folder / 'compare.html'}\n", flush=True
        )


def tables(name: str, folder: Path, options: argparse.Namespace) -> str:
    """Of one comparison, measured as far as it is not there."""
    config: Config = load_config(CONFIGS / ("default.yaml" if name == "run" else f"compare/{name}.yaml"), {})
    if options.stored:
        return markdown(read_comparison(folder / FILE), config.backend.solver)
    if name == "run" and not options.run.is_dir():
        return f"{options.run} is not there: python -m benchmarks.end_to_end.scenes makes it"
    run = options.run if name == "run" else None
    truth = options.sequence if run and (options.sequence / "mav0" / "target0").is_dir() else None
    found = compare(config, folder, choose_progress(), run=run, truth=truth)
    return markdown(found, config.backend.solver)


if __name__ == "__main__":
    main()
