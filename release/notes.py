"""The release notes: the changelog's section of a version, and how to install it and check its files."""

import re
from dataclasses import dataclass

from polhode.errors import InputError

UNRELEASED = "Unreleased"
HEADING = re.compile(r"^## \[(?P<name>[^\]]+)\](?: - (?P<date>\d{4}-\d{2}-\d{2}))?[ \t]*$", re.MULTILINE)


@dataclass(frozen=True)
class Section:
    """What the changelog says about one version."""

    name: str
    """The version, or 'Unreleased'"""
    date: str | None
    """Of the release, YYYY-MM-DD"""
    text: str


def sections(changelog: str) -> list[Section]:
    """All sections, in the order of the file (Keep a Changelog: the newest first)."""
    found = list(HEADING.finditer(changelog))
    ends = [each.start() for each in found[1:]] + [len(changelog)]
    return [
        Section(each["name"], each["date"], changelog[each.end() : end].strip())
        for each, end in zip(found, ends, strict=True)
    ]


def section_of(changelog: str, version: str, is_dry_run: bool) -> Section:
    """The section of ``version``; a dry run takes what is unreleased where the version has none yet.

    Raises InputError: there is none, it is empty, or has no date.
    """
    by_name = {each.name: each for each in sections(changelog)}
    section = by_name.get(version)
    if section is None and is_dry_run:
        section = by_name.get(UNRELEASED)
    if section is None:
        raise InputError(
            f"CHANGELOG.md has no section '## [{version}] - YYYY-MM-DD': "
            f"give what is under [{UNRELEASED}] this title"
        )
    if not section.text:
        raise InputError(
            f"CHANGELOG.md has nothing under [{section.name}]: say there what the release changes"
        )
    if section.date is None and not is_dry_run:
        raise InputError(f"CHANGELOG.md has no date beside [{version}]: write '## [{version}] - YYYY-MM-DD'")
    return section


def release_notes(section: Section, version: str, files: list[str]) -> str:
    """The notes in Markdown; ``files`` are the names of those that are released."""
    wheel = next(name for name in files if name.endswith(".whl"))
    date = f", {section.date}" if section.date else ""
    listed = "\n".join(f"- `{name}`" for name in files)
    return f"""# polhode {version}{date}

{section.text}

## Installation

```
sha256sum --check --ignore-missing SHA256SUMS
python -m pip install --constraint constraints.txt ./{wheel}
```

`constraints.txt` pins the versions of all dependencies that this release was tested with.

## Files

{listed}
"""
