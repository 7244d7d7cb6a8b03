"""The page of validation: every benchmark of the registry, with its command and the date of its results."""

import posixpath
import subprocess
from pathlib import Path

from benchmarks.record import lines_of
from benchmarks.registry import BENCHMARKS, Benchmark

_HEADS = {
    "calibration": "Calibration", "checkout": "Checkout", "edges": "Observability from edges",
    "end_to_end": "From images to the answer", "frontend": "Features, matches, disparity, masks",
    "live": "Live and long sequences",
    "mapping": "Depth and mesh", "monte_carlo": "Monte Carlo: accuracy and consistency",
    "mutation": "The test suite itself", "navigation": "Navigation filter", "planning": "Planning",
    "rendering": "Renderer", "robustness": "Robustness", "solvers": "Solvers", "trust": "Trust",
}  # fmt: skip


def benchmarks_page(root: Path) -> str:
    """Markdown."""
    text = (
        "# Benchmarks\n\n"
        "Every number of these pages that was measured has a command that prints it. The table is made from "
        "the registry that `make bench` runs. *Minutes* are those of one core, roughly. *Results of* is the "
        "day of the last record that the repository keeps of a benchmark (**record**), or, where it keeps "
        "none, the day on which the page that quotes the numbers was last changed (**page**). The tables "
        "themselves stand in the linked pages.\n\n"
        "`python -m benchmarks NAME` runs one of them, `make bench` all, and `--short` a short form that "
        "takes seconds, which shows that the command works and not the same numbers.\n"
    )
    for topic in dict.fromkeys(each.topic for each in BENCHMARKS):
        text += f"\n## {_HEADS.get(topic, topic)}\n\n"
        text += (
            "| name | what it prints | command | minutes | results of | page |\n|---|---|---|---|---|---|\n"
        )
        text += "".join(_row(each, root) for each in BENCHMARKS if each.topic == topic)
    return text


def _row(benchmark: Benchmark, root: Path) -> str:
    command = " ".join(["python -m", f"benchmarks.{benchmark.module}", *benchmark.full.split()])
    page = posixpath.basename(benchmark.page)
    link = f"[{page.removesuffix('.md')}]({_page_link(benchmark.page)})" if page else "-"
    prints = benchmark.prints.replace("|", "\\|")
    cells = (
        f"`{benchmark.name}`",
        prints,
        f"`{command}`",
        f"{benchmark.minutes:g}",
        day_of(benchmark, root),
        link,
    )
    return "| " + " | ".join(cells) + " |\n"


def _page_link(page: str) -> str:
    return "../readme.md" if page == "README.md" else f"../{page.removeprefix('docs/')}"


def day_of(benchmark: Benchmark, root: Path) -> str:
    """Day of the last record of a benchmark, else that of the last change of its page; empty: unknown."""
    recorded = _last_time(root / "benchmarks" / "records" / record_name(benchmark))
    if recorded:
        return f"{recorded[:10]} (record)"
    changed = _last_change(root, benchmark.page) if benchmark.page else ""
    return f"{changed} (page)" if changed else "-"


def record_name(benchmark: Benchmark) -> str:
    """Name of the folder of the record: that of the module, with one exception."""
    module = benchmark.module.rpartition(".")[2]
    return {"disturbances": "pushes"}.get(module, module)


def _last_time(record: Path) -> str:
    return max((str(line.get("made", {}).get("time", "")) for line in lines_of(record)), default="")


def _last_change(root: Path, page: str) -> str:
    """Day of the last commit that changed a page; empty outside of a checkout."""
    words = ["git", "log", "-1", "--format=%cs", "--", page]
    done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""
