"""What the project's studies say, in tables with intervals of 95 %, from the tables in docs/study_results.

    python -m benchmarks.studies.findings [NAME ...] [--folder DIR] [--page FILE]

Without a name, of every study that is there. ``--folder``: where the folders of the studies are. A finding
may need two studies. The page docs/study_findings.md quotes what is printed; ``--page`` replaces its
tables, each below its title, in the section that shows the command of the finding.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from benchmarks.command import ROOT, command
from benchmarks.studies.image_findings import (
    light,
    noise_and_resolution,
    of_images,
    rig_for_target,
    share_of_texture,
)
from benchmarks.studies.mission_findings import one_mission
from benchmarks.studies.motion_findings import (
    frame_rate_against_spin,
    revolutions_and_inertia,
    revolutions_or_pairs,
)
from benchmarks.studies.solver_findings import optimizers_over_bodies
from benchmarks.studies.study_results import Part, read_results
from benchmarks.studies.trust_findings import every_run
from polhode.atomic import write_text
from polhode.studies.table import TABLE

COMMAND = "python -m benchmarks.studies.findings"
RESULTS = ROOT / "docs" / "study_results"

EVALUATED = (
    "frame_rate_against_spin",
    "revolutions_and_inertia",
    "rig_for_target",
    "noise_and_resolution",
    "share_of_texture",
    "light",
    "front_ends",
    "front_ends_of_scenes",
    "one_mission",
)
"""Studies whose runs are compared with the truth"""


@dataclass(frozen=True)
class Finding:
    """Tables, and the studies that they are made from."""

    parts: Callable[..., list[Part]]
    """Of the results of each study"""
    studies: tuple[str, ...] = ()
    """Names of folders; empty: that of its own name"""
    of_any: bool = False
    """Whether those that are there are enough"""


FINDINGS: dict[str, Finding] = {
    "frame_rate_against_spin": Finding(frame_rate_against_spin),
    "revolutions_and_inertia": Finding(revolutions_and_inertia),
    "revolutions_or_pairs": Finding(
        revolutions_or_pairs, ("frame_rate_against_spin", "revolutions_and_inertia")
    ),
    "rig_for_target": Finding(rig_for_target),
    "noise_and_resolution": Finding(noise_and_resolution),
    "share_of_texture": Finding(share_of_texture),
    "light": Finding(light),
    "front_ends": Finding(of_images),
    "front_ends_of_scenes": Finding(of_images),
    "optimizers_over_bodies": Finding(optimizers_over_bodies),
    "one_mission": Finding(one_mission),
    "every_run": Finding(every_run, EVALUATED, of_any=True),
}


def main(
    names: Positional[Annotated[tuple[str, ...], arg(metavar="NAME", help="Of findings.")]] = (),
    folder: Annotated[Path, arg(metavar="DIR", help="Of the studies' folders.")] = RESULTS,
    page: Annotated[Path | None, arg(metavar="FILE", help="Markdown with tables of findings.")] = None,
) -> None:
    """Print the tables, and write them into a page that has them."""
    if unknown := [name for name in names if name not in FINDINGS]:
        raise SystemExit(f"{unknown[0]}: no such finding; there are: {', '.join(FINDINGS)}")
    there = [name for name in FINDINGS if not missing(name, folder)]
    for name in names:
        if name not in there:
            raise SystemExit(f"{name}: {folder / missing(name, folder)[0] / TABLE} is missing")
    text = "" if page is None else page.read_text()
    for name in names or there:
        print(f"## {name}\n")
        parts = parts_of(name, folder)
        for part in parts:
            print(f"### {part.title}\n\n{part.table}\n")
        text = with_tables(text, name, parts)
    if page is not None:
        write_text(page, text)


def with_tables(page: str, name: str, parts: Sequence[Part]) -> str:
    """A page whose section of a finding has its tables as they are now; the others stay out of it."""
    sections = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    for k, section in enumerate(sections):
        if re.search(rf"^{COMMAND} {name}$", section, re.MULTILINE):
            for part in parts:
                shown = re.compile(rf"(^{re.escape(part.title)}:\n\n)(?:\|.*\n)+", re.MULTILINE)
                table = part.table + "\n"
                section = shown.sub(lambda match, table=table: match[1] + table, section)
            sections[k] = section
    return "".join(sections)


def missing(name: str, folder: Path) -> list[str]:
    """Studies without a table that a finding needs."""
    lacking = [each for each in studies_of(name) if not (folder / each / TABLE).is_file()]
    return [] if FINDINGS[name].of_any and len(lacking) < len(studies_of(name)) else lacking


def studies_of(name: str) -> tuple[str, ...]:
    """Names of the studies that a finding is made from."""
    return FINDINGS[name].studies or (name,)


def parts_of(name: str, folder: Path = RESULTS) -> list[Part]:
    """The tables of a finding."""
    there = [folder / each for each in studies_of(name) if (folder / each / TABLE).is_file()]
    return FINDINGS[name].parts(*map(read_results, there))


if __name__ == "__main__":
    command(main)
