"""The version to release. The tag says which one; the files that state it must agree.

``pyproject.toml`` holds the version, so that an archive without git, an editable installation and the bill of
materials know it. A tag ``v1.2.3`` releases exactly the version 1.2.3: one that differs is refused.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import yaml
from packaging.version import InvalidVersion, Version

from polhode.errors import InputError, RunFailure
from release.commands import call


@dataclass(frozen=True)
class Candidate:
    """A commit and the version that it states."""

    commit: str
    version: str
    time_s: int
    """Of the commit [s since 1970]: the date of the files in the archives"""


def candidate(root: Path, is_dry_run: bool) -> Candidate:
    """The commit to release of the checkout ``root``.

    Raises InputError: no checkout; without ``is_dry_run`` also a changed file or a missing, ambiguous or
    different tag.
    """
    version = stated_version(root)
    try:
        commit, time_s = call(root, "git", "log", "-1", "--format=%H %ct").split()
        changes = call(root, "git", "status", "--porcelain").splitlines()
        tags = call(root, "git", "tag", "--points-at", "HEAD").split()
    except RunFailure as failure:
        raise InputError(f"{root} is no checkout with a commit: {failure}") from failure
    if not is_dry_run:
        require_clean(changes)
        require_tag(tags, version)
    return Candidate(commit, version, int(time_s))


def require_clean(changes: list[str]) -> None:
    """Raise InputError: ``changes``, the lines of ``git status --porcelain``, name a file."""
    if changes:
        more = f" and {len(changes) - 1} more" if len(changes) > 1 else ""
        raise InputError(
            f"the working tree has uncommitted changes ({changes[0][3:]}{more}): commit or remove them first"
        )


def require_tag(tags: list[str], version: str) -> None:
    """Raise InputError: ``tags``, those of the commit, do not name exactly ``version``."""
    named = [tag for tag in tags if is_release_tag(tag)]
    if not named:
        raise InputError(
            f"the commit has no tag of a release: run 'git tag -a v{version} -m v{version}', "
            "or try without one: make release OPTIONS=--dry-run"
        )
    if len(named) > 1:
        raise InputError(f"the commit has several tags of releases ({', '.join(named)}): remove all but one")
    if named[0] != f"v{version}":
        raise InputError(
            f"the tag is {named[0]} and pyproject.toml has the version {version}: "
            "make them the same, commit, and move the tag"
        )


def is_release_tag(tag: str) -> bool:
    """Whether a tag is a 'v' and a version in its normal form (PEP 440)."""
    try:
        return tag == f"v{Version(tag[1:])}"
    except InvalidVersion:
        return False


def stated_version(root: Path) -> str:
    """The version in pyproject.toml. Raises InputError: CITATION.cff states another one."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    version = str(project["version"])
    cited = citation(root).get("version")
    if cited != version:
        raise InputError(
            f"CITATION.cff has the version {cited}, pyproject.toml {version}: make them the same"
        )
    return version


def require_cited_date(root: Path, date: str) -> None:
    """Raise InputError: CITATION.cff states another date of release than the changelog's ``date``."""
    cited = citation(root).get("date-released")
    if str(cited) != date:
        raise InputError(f"CITATION.cff has the date {cited}, the changelog {date}: make them the same")


def citation(root: Path) -> dict[str, object]:
    """The content of CITATION.cff."""
    content: dict[str, object] = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    return content
