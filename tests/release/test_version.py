"""A release is what its tag names; files that state a version agree; notes are the changelog's."""

import shutil
import subprocess
from pathlib import Path

import pytest

from lab.release.version import RELEASE_TAG, candidate, release_notes, section_of, stated_version
from polhode.runtime.errors import InputError

ROOT = Path(__file__).parents[2]
PERSON = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
CHANGELOG = """# Changelog

## [Unreleased]

## [1.2.0] - 2030-01-02

### Added

- Something new.

## [1.1.0]

- Older.
"""


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", *PERSON, *words], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository whose only commit states version 1.2.0."""
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "polhode"\nversion = "1.2.0"\n')
    (tmp_path / "CITATION.cff").write_text("version: 1.2.0\ndate-released: 2030-01-02\n")
    (tmp_path / "CHANGELOG.md").write_text(CHANGELOG)
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "first")
    return tmp_path


def test_a_tagged_commit_is_released_in_its_version_with_the_notes_of_the_changelog(checkout: Path) -> None:
    git(checkout, "tag", "--annotate", "v1.2.0", "--message", "v1.2.0")
    git(checkout, "tag", "reviewed")
    found = candidate(checkout, is_dry_run=False)
    assert (found.commit, found.version) == (git(checkout, "rev-parse", "HEAD"), "1.2.0")
    assert str(found.time_s) == git(checkout, "log", "-1", "--format=%ct")
    notes = release_notes(found, ["polhode-1.2.0-py3-none-any.whl", "polhode-1.2.0.tar.gz"])
    assert notes.startswith(
        "# polhode 1.2.0, 2030-01-02\n\n### Added\n\n- Something new.\n\n## Installation\n"
    )
    assert "./polhode-1.2.0-py3-none-any.whl\n" in notes
    assert notes.endswith("- `polhode-1.2.0-py3-none-any.whl`\n- `polhode-1.2.0.tar.gz`\n")


def test_a_commit_without_its_one_tag_can_be_tried_but_not_released(checkout: Path) -> None:
    with pytest.raises(InputError, match=r"has no tag of a release: run 'git tag -a v1\.2\.0"):
        candidate(checkout, is_dry_run=False)
    assert candidate(checkout, is_dry_run=True).version == "1.2.0"
    git(checkout, "tag", "v1.3.0")
    with pytest.raises(InputError, match=r"the tag is v1\.3\.0 and pyproject\.toml has the version 1\.2\.0"):
        candidate(checkout, is_dry_run=False)
    git(checkout, "tag", "v1.2.0")
    with pytest.raises(InputError, match=r"the tag is v1\.2\.0, v1\.3\.0 and"):
        candidate(checkout, is_dry_run=False)


def test_changed_and_new_files_are_refused_and_named(checkout: Path) -> None:
    git(checkout, "tag", "v1.2.0")
    (checkout / "new.py").touch()
    with pytest.raises(InputError, match=r"uncommitted changes \(new\.py\): commit or remove"):
        candidate(checkout, is_dry_run=False)
    (checkout / "CITATION.cff").write_text("version: 1.2.0\n")
    with pytest.raises(InputError, match=r"uncommitted changes \(CITATION\.cff and 1 more\)"):
        candidate(checkout, is_dry_run=False)


def test_a_folder_without_git_is_refused_but_knows_its_version(checkout: Path) -> None:
    shutil.rmtree(checkout / ".git")
    assert stated_version(checkout) == "1.2.0"
    with pytest.raises(InputError, match="is no checkout with a commit"):
        candidate(checkout, is_dry_run=True)


def test_the_citation_must_agree(checkout: Path) -> None:
    (checkout / "CITATION.cff").write_text("version: 1.2.0\ndate-released: 2030-01-03\n")
    git(checkout, "commit", "--quiet", "--all", "--message", "another date")
    git(checkout, "tag", "v1.2.0")
    with pytest.raises(InputError, match=r"CITATION\.cff has the date 2030-01-03, the changelog 2030-01-02"):
        candidate(checkout, is_dry_run=False)
    (checkout / "CITATION.cff").write_text("version: 1.1.0\n")
    with pytest.raises(InputError, match=r"CITATION\.cff has the version 1\.1\.0, pyproject\.toml 1\.2\.0"):
        stated_version(checkout)


def test_tags_of_releases_are_versions_in_their_normal_form() -> None:
    assert all(map(RELEASE_TAG.fullmatch, ("v1.2.0", "v1.2", "v1.2.0rc1")))
    assert not any(map(RELEASE_TAG.fullmatch, ("1.2.0", "v", "version", "v1.2.0-rc1", "v01.2.0")))


@pytest.mark.parametrize(
    ("version", "fault"),
    [
        (
            "1.3.0",
            r"has no section '## \[1\.3\.0\] - YYYY-MM-DD': give what is under \[Unreleased\] this title",
        ),
        ("Unreleased", r"has nothing under \[Unreleased\]"),
        ("1.1.0", r"has no date beside \[1\.1\.0\]"),
    ],
)
def test_a_version_without_a_complete_section_is_refused(version: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        section_of(CHANGELOG, version, is_dry_run=False)


def test_a_dry_run_takes_what_is_unreleased() -> None:
    changelog = CHANGELOG.replace("## [Unreleased]\n", "## [Unreleased]\n\n- To come.\n")
    assert section_of(changelog, "1.3.0", is_dry_run=True) == ("- To come.", None)
    assert section_of(CHANGELOG, "1.1.0", is_dry_run=True) == ("- Older.", None)


def test_this_repository_can_be_tried() -> None:
    version = stated_version(ROOT)
    assert RELEASE_TAG.fullmatch(f"v{version}")
    assert section_of((ROOT / "CHANGELOG.md").read_text(), version, is_dry_run=True)[0]
