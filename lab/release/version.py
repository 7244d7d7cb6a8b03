"""The commit and the version to release, what must agree with them, and the release notes.

``pyproject.toml`` holds the version, so that an archive without git, an editable installation and the bill of
materials know it. A tag ``v1.2.3`` releases exactly the version 1.2.3, of which the changelog has a dated
section.
"""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import yaml

from lab.release.commands import call
from polhode.runtime.errors import InputError, RunFailure

HEADING = re.compile(r"^## \[(?P<name>[^\]]+)\](?: - (?P<date>\d{4}-\d{2}-\d{2}))?[ \t]*$", re.MULTILINE)
RELEASE_TAG = re.compile(r"v(0|[1-9]\d*)(\.(0|[1-9]\d*)){1,2}((a|b|rc)\d+)?")


@dataclass(frozen=True)
class Candidate:
    """A commit and the version that it states."""

    commit: str
    version: str
    time_s: int
    """Of the commit [s since 1970]: the date of the files in the archives"""
    changes: str
    """The changelog's section of the version"""
    date: str | None
    """Of the release, YYYY-MM-DD"""


def candidate(root: Path, is_dry_run: bool) -> Candidate:
    """The commit to release of the checkout ``root``; a dry run takes any commit, and what is unreleased.

    Raises InputError: no checkout, versions that differ, or no section in the changelog; without
    ``is_dry_run`` also uncommitted files, a missing or different tag, a date that is missing or differs.
    """
    version = stated_version(root)
    try:
        commit, time_s = call(root, "git", "log", "-1", "--format=%H %ct").split()
        uncommitted = call(root, "git", "status", "--porcelain").splitlines()
        tags = call(root, "git", "tag", "--points-at", "HEAD").split()
    except RunFailure as failure:
        raise InputError(f"{root} is no checkout with a commit: {failure}") from failure
    if not is_dry_run:
        _require_tag(uncommitted, tags, version)
    changes, date = section_of((root / "CHANGELOG.md").read_text(encoding="utf-8"), version, is_dry_run)
    cited = citation(root).get("date-released")
    if not is_dry_run and str(cited) != date:
        raise InputError(f"CITATION.cff has the date {cited}, the changelog {date}: make them the same")
    return Candidate(commit, version, int(time_s), changes, date)


def _require_tag(uncommitted: list[str], tags: list[str], version: str) -> None:
    """Raise InputError unless all is committed, and tagged as ``version`` alone."""
    if uncommitted:
        more = f" and {len(uncommitted) - 1} more" if len(uncommitted) > 1 else ""
        named = f"{uncommitted[0][3:]}{more}"
        raise InputError(f"the working tree has uncommitted changes ({named}): commit or remove them first")
    named_tags = [tag for tag in tags if RELEASE_TAG.fullmatch(tag)]
    if not named_tags:
        raise InputError(
            f"the commit has no tag of a release: run 'git tag -a v{version} -m v{version}', "
            "or try without one: make release OPTIONS=--dry-run"
        )
    if named_tags != [f"v{version}"]:
        raise InputError(
            f"the tag is {', '.join(named_tags)} and pyproject.toml has the version {version}: "
            "make them the same, commit, and move the tag"
        )


def stated_version(root: Path) -> str:
    """The version in pyproject.toml. Raises InputError: CITATION.cff states another one."""
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    cited = citation(root).get("version")
    if cited != version:
        raise InputError(
            f"CITATION.cff has the version {cited}, pyproject.toml {version}: make them the same"
        )
    return str(version)


def citation(root: Path) -> dict[str, object]:
    """The content of CITATION.cff."""
    content: dict[str, object] = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    return content


def section_of(changelog: str, version: str, is_dry_run: bool) -> tuple[str, str | None]:
    """Text and date of a version's section; a dry run takes what is unreleased where there is none yet.

    Raises InputError: there is none, it is empty, or has no date.
    """
    heads = list(HEADING.finditer(changelog))
    ends = [each.start() for each in heads[1:]] + [len(changelog)]
    sections = {
        each["name"]: (changelog[each.end() : end].strip(), each["date"])
        for each, end in zip(heads, ends, strict=True)
    }
    title = f"## [{version}] - YYYY-MM-DD"
    name = "Unreleased" if is_dry_run and version not in sections else version
    if name not in sections:
        raise InputError(f"CHANGELOG.md has no section '{title}': give what is under [Unreleased] this title")
    text, date = sections[name]
    if not text:
        raise InputError(f"CHANGELOG.md has nothing under [{name}]: say there what the release changes")
    if date is None and not is_dry_run:
        raise InputError(f"CHANGELOG.md has no date beside [{version}]: write '{title}'")
    return text, date


def release_notes(chosen: Candidate, files: list[str]) -> str:
    """The notes in Markdown; ``files`` are the names of those that are released."""
    wheel = next(name for name in files if name.endswith(".whl"))
    date = f", {chosen.date}" if chosen.date else ""
    listed = "\n".join(f"- `{name}`" for name in files)
    return f"""# polhode {chosen.version}{date}

{chosen.changes}

## Installation

```
sha256sum --check --ignore-missing SHA256SUMS
python -m pip install --constraint constraints.txt ./{wheel}
```

`constraints.txt` pins the versions of all dependencies that this release was tested with.

## Files

{listed}
"""
