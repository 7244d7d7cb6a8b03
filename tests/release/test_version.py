"""A release is exactly what its tag names, and every file that states a version agrees."""

import shutil
import subprocess
from pathlib import Path

import pytest

from polhode.errors import InputError
from release.version import candidate, is_release_tag, require_cited_date, stated_version

ROOT = Path(__file__).parents[2]
PERSON = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", *PERSON, *words], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository whose only commit states version 1.2.0."""
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "polhode"\nversion = "1.2.0"\n')
    (tmp_path / "CITATION.cff").write_text("version: 1.2.0\ndate-released: 2030-01-02\n")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "first")
    return tmp_path


def test_a_tagged_commit_is_released_in_its_version(checkout: Path) -> None:
    git(checkout, "tag", "--annotate", "v1.2.0", "--message", "v1.2.0")
    git(checkout, "tag", "reviewed")
    found = candidate(checkout, is_dry_run=False)
    assert (found.commit, found.version) == (git(checkout, "rev-parse", "HEAD"), "1.2.0")
    assert str(found.time_s) == git(checkout, "log", "-1", "--format=%ct")


def test_a_commit_without_a_tag_can_be_tried_but_not_released(checkout: Path) -> None:
    with pytest.raises(InputError, match=r"has no tag of a release: run 'git tag -a v1\.2\.0"):
        candidate(checkout, is_dry_run=False)
    assert candidate(checkout, is_dry_run=True).version == "1.2.0"


def test_a_tag_of_another_version_is_refused(checkout: Path) -> None:
    git(checkout, "tag", "v1.3.0")
    with pytest.raises(InputError, match=r"the tag is v1\.3\.0 and pyproject\.toml has the version 1\.2\.0"):
        candidate(checkout, is_dry_run=False)
    git(checkout, "tag", "v1.2.0")
    with pytest.raises(InputError, match=r"several tags of releases \(v1\.2\.0, v1\.3\.0\)"):
        candidate(checkout, is_dry_run=False)


def test_a_changed_or_a_new_file_is_refused_and_named(checkout: Path) -> None:
    git(checkout, "tag", "v1.2.0")
    (checkout / "new.py").touch()
    with pytest.raises(InputError, match=r"uncommitted changes \(new\.py\): commit or remove"):
        candidate(checkout, is_dry_run=False)
    (checkout / "CITATION.cff").write_text("version: 1.2.0\n")
    with pytest.raises(InputError, match=r"uncommitted changes \(CITATION\.cff and 1 more\)"):
        candidate(checkout, is_dry_run=False)


def test_a_folder_without_git_is_refused_but_knows_its_version(checkout: Path, tmp_path: Path) -> None:
    shutil.rmtree(checkout / ".git")
    assert stated_version(checkout) == "1.2.0"
    with pytest.raises(InputError, match="is no checkout with a commit"):
        candidate(checkout, is_dry_run=True)


def test_the_citation_must_agree(checkout: Path) -> None:
    require_cited_date(checkout, "2030-01-02")
    with pytest.raises(InputError, match=r"CITATION\.cff has the date 2030-01-02, the changelog 2030-01-03"):
        require_cited_date(checkout, "2030-01-03")
    (checkout / "CITATION.cff").write_text("version: 1.1.0\n")
    with pytest.raises(InputError, match=r"CITATION\.cff has the version 1\.1\.0, pyproject\.toml 1\.2\.0"):
        stated_version(checkout)


def test_this_repository_states_one_version() -> None:
    assert is_release_tag(f"v{stated_version(ROOT)}")


@pytest.mark.parametrize("tag", ["1.2.0", "v1.2", "v1.2.0", "v1.2.0rc1"])
def test_tags_of_releases_are_versions_in_their_normal_form(tag: str) -> None:
    assert is_release_tag(tag) == tag.startswith("v")


@pytest.mark.parametrize("tag", ["v", "version", "v1.2.0-rc1", "v01.2.0"])
def test_other_tags_are_none(tag: str) -> None:
    assert not is_release_tag(tag)
