"""Optimizers side by side: the pages and tables of docs/compare.md.

    python -m benchmarks.solvers.compare [NAME ...] [--short] [-o FOLDER] [--run RUN] [--sequence SEQ]
                                        [--stored]

A NAME is that of a file of configs/compare, or ``run``: configs/default.yaml on a stored run (made by
``python -m benchmarks.end_to_end.scenes``), with the truth of its sequence when that is there. Without a
name: ``run``, profiles, seeds, growth and ablations. Pages go to FOLDER/NAME; what was measured before is
read from there, so that an interrupted benchmark goes on where it stopped. ``--stored``: nothing is measured,
the tables of what FOLDER holds are printed. ``--short``: every solver once on a small problem.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from benchmarks.command import ROOT, Short, command
from benchmarks.presentation import markdown_table
from polhode.compare.comparison import FILE, compare
from polhode.compare.problem.assessment import AGREED
from polhode.compare.ranking import NOISE, beaten_by, curve, front, growths
from polhode.compare.rows import Comparison, ProblemSummary, Row, read_comparison
from polhode.compare.tables import ERROR_COLUMNS, cells, error_cells, not_separable, tally_text, verdict
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.console import choose_progress
from polhode.threads import limit_threads

Name = Literal["short", "run", "profiles", "seeds", "growth", "ablations"]
LONG: tuple[Name, ...] = ("run", "profiles", "seeds", "growth", "ablations")


def main(
    names: Positional[tuple[Name, ...]] = LONG,
    short: Short = False,
    stored: Annotated[bool, arg(help="Only print what was measured before.")] = False,
    output: Annotated[Path, arg(aliases=["-o"], help="Folder of the results.")] = Path("runs/compare"),
    run: Annotated[Path, arg(help="Stored run to compare on.")] = Path("runs/ts38"),
    sequence: Annotated[Path, arg(help="Sequence of that run, for its truth.")] = Path("data/ts38"),
) -> None:
    """Compare the solvers and print the tables."""
    limit_threads(1)
    for name in ("short",) if short else names:
        folder = output / name
        if stored and not (folder / FILE).is_file():
            print(f"{name}: nothing stored in {folder}\n")
            continue
        config = load_config(
            ROOT / "configs" / ("default.yaml" if name == "run" else f"compare/{name}.yaml"), {}
        )
        found = read_comparison(folder / FILE) if stored else _compared(name, folder, config, run, sequence)
        text = found if isinstance(found, str) else markdown(found, LEADS)
        print(f"## {name}\n\n{text}\n\nPage: {folder / 'compare.html'}\n", flush=True)


def _compared(name: str, folder: Path, config: Config, run: Path, sequence: Path) -> Comparison | str:
    """One comparison, measured as far as it is not there; or why it cannot be made."""
    if name != "run":
        return compare(config, folder, choose_progress())
    if not run.is_dir():
        return f"{run} is not there: python -m benchmarks.end_to_end.scenes makes it"
    truth = sequence if (sequence / "mav0" / "target0").is_dir() else None
    return compare(config, folder, choose_progress(), run=run, truth=truth)


LEADS = "gauss_newton"
"""The solver that leads to the optimum of a run; where it ends, IPOPT continues."""
WITHIN = (1.0, 2.0, 5.0, 10.0)
"""Factors of the fastest solver's time whose shares are printed."""
SHOWN = ("solver", "status", "over least", "iter", "time s", "build", "eval", "linear", "Python s", "MB",
         "MB before", "sigma k1", "sigma k2")  # fmt: skip


def markdown(found: Comparison, own: str) -> str:
    """All tables that a comparison gives, and where the solver ``own`` stands."""
    parts = [solver_table(found, problem) for problem in found.problems] if len(found.problems) == 1 else []
    tables: Sequence[Callable[[Comparison], str]] = (
        motions_table, growth_table, starts_table, profile_table, errors_table,
    )  # fmt: skip
    parts += [table(found) for table in tables]
    parts.append("\n".join(front_words(found, problem) for problem in found.problems))
    parts.append(place_table(found, own))
    return "\n\n".join(part for part in parts if part)


def solver_table(found: Comparison, problem: ProblemSummary) -> str:
    """One problem from the cold start, all that is known of a row's price."""
    rows = _cold(found, problem.name)
    if not rows:
        return ""
    lines = []
    for row in rows:
        shown = cells(row, problem.least_cost)
        callback = "" if row.callback_s is None else f"{row.callback_s:.2f}"
        before = "" if row.memory_before_mb is None else f"{row.memory_before_mb:.0f}"
        lines.append([shown[0], *shown[2:9], callback, shown[9], before, *shown[10:]])
    below = [*not_separable(rows), verdict(rows, problem.least_cost)]
    return _headed(problem, markdown_table(SHOWN, lines)) + "".join(f"\n\n{line}" for line in below)


def motions_table(found: Comparison) -> str:
    """Iterations and seconds from the cold start, of problems that differ in their motion."""
    if len(found.problems) < 2:
        return ""
    solvers = list(dict.fromkeys(row.solver for row in found.rows if row.start == "cold"))
    lines = [[solver, *(_outcome(found, solver, each) for each in found.problems)] for solver in solvers]
    if not lines:
        return ""
    head = ["iterations / seconds", *(each.name for each in found.problems)]
    return markdown_table(head, lines)


def growth_table(found: Comparison) -> str:
    """Seconds at each size and the exponent, of solvers that solved three sizes or more."""
    grown = growths(found)
    if not grown:
        return ""
    sizes = sorted({int(n) for each in grown for n in each.size})
    lines = []
    for each in grown:
        seconds = dict(zip(each.size.astype(int).tolist(), each.seconds.tolist(), strict=True))
        times = [f"{seconds[n]:.2f}" if n in seconds else "" for n in sizes]
        lines.append([each.solver, *times, f"{each.exponent:.2f}"])
    return markdown_table(["seconds at observations", *map(str, sizes), "exponent"], lines)


def starts_table(found: Comparison) -> str:
    """Cases solved of those that were run, by kind of start."""
    kinds = list(dict.fromkeys(row.start for row in found.rows))
    if len({(row.start, row.seed) for row in found.rows}) < 2:
        return ""
    lines = [
        [each.solver, *(tally_text(each.starts[kind]) if kind in each.starts else "" for kind in kinds)]
        for each in found.profiles
    ]
    return markdown_table(["solved", *(f"{kind} starts" for kind in kinds)], lines)


def profile_table(found: Comparison) -> str:
    """Share of the cases that a solver ran and solved within a factor of the fastest one's time."""
    if len({(row.problem, row.start, row.seed) for row in found.rows}) < 2:
        return ""
    lines = []
    for each in found.profiles:
        factor, share = curve(each)
        within = [f"{max(share[factor <= limit], default=0.0):.0%}" for limit in WITHIN]
        shares = [*within, f"{share[-1]:.0%}"] if each.ran else [""] * (len(WITHIN) + 1)
        lines.append([each.solver, str(each.ran), str(each.not_run), *shares])
    head = ["profile", "cases run", "not run", *(f"within {limit:g}x" for limit in WITHIN), "solved"]
    return markdown_table(head, lines)


def errors_table(found: Comparison) -> str:
    """Errors against the truth from the cold start, same ones together; nothing without it."""
    lines = []
    for problem in found.problems:
        same: dict[tuple[str, ...], list[str]] = {}
        for row in _cold(found, problem.name):
            if row.errors is not None and row.status in ("ok", "baseline"):
                same.setdefault(tuple(error_cells(row.errors)), []).append(row.solver)
        lines += [[problem.name, ", ".join(who), *numbers] for numbers, who in same.items()]
    if not lines:
        return ""
    head = ["problem", "solvers", *ERROR_COLUMNS]
    return markdown_table(head, lines)


def front_words(found: Comparison, problem: ProblemSummary) -> str:
    """Who is on the Pareto front of time against accuracy."""
    rows = _cold(found, problem.name)
    names = [row.solver for row in front(rows, problem.least_cost)]
    return f"{problem.name}: on the front: {', '.join(names)}" if names else ""


def place_table(found: Comparison, solver: str) -> str:
    """One solver on each problem from the cold start, and the solvers that beat it."""
    lines, on_front = [], 0
    for problem in found.problems:
        rows = _cold(found, problem.name)
        own = next((row for row in rows if row.solver == solver), None)
        if own is None:
            lines.append([problem.name, "not run", "", "", ""])
            continue
        better = beaten_by(own, rows, problem.least_cost)
        good = own.status == "ok" and not better
        on_front += good
        # the three fastest are named
        names = [f"{row.solver} ({row.wall_s or 0.0:.2f} s)" for row in better[:3]]
        more = [f"{len(better) - 3} more"] if len(better) > 3 else []
        time = "" if own.wall_s is None else f"{own.wall_s:.2f}"
        lines.append([problem.name, own.status, time, "yes" if good else "no", ", ".join([*names, *more])])
    head = (
        f"{solver}: on the front of time against accuracy on {on_front} of {len(lines)} "
        f"problems (cold starts; times within {NOISE:.0%} and costs within {AGREED:g} count as equal)"
    )
    columns = ["problem", "status", "time s", "on the front", "beaten by"]
    return f"{head}\n{markdown_table(columns, lines)}"


def _outcome(found: Comparison, solver: str, problem: ProblemSummary) -> str:
    row = next((each for each in _cold(found, problem.name) if each.solver == solver), None)
    if row is None:
        return ""
    if not row.ran or row.wall_s is None:
        return "not run"
    out = f"{row.iterations} / {row.wall_s:.1f}"
    return out if row.status == "ok" else f"{out}, {row.status}, cost +{cells(row, problem.least_cost)[3]}"


def _cold(found: Comparison, problem: str) -> list[Row]:
    return [row for row in found.rows if row.problem == problem and row.start == "cold"]


def _headed(problem: ProblemSummary, table: str) -> str:
    size = f"{problem.frames} frames, {problem.landmarks} landmarks, {problem.observations} observations"
    return f"{problem.name}: {size}, {problem.unknowns} unknowns\n\n{table}"


if __name__ == "__main__":
    command(main)
