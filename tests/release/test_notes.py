"""The notes are the changelog's section of the version."""

from pathlib import Path

import pytest

from polhode.errors import InputError
from release.notes import release_notes, section_of, sections

ROOT = Path(__file__).parents[2]
CHANGELOG = """# Changelog

## [Unreleased]

## [1.2.0] - 2030-01-02

### Added

- Something new.

## [1.1.0]

- Older.
"""


def test_sections_end_where_the_next_begins() -> None:
    found = sections(CHANGELOG)
    assert [(each.name, each.date) for each in found] == [
        ("Unreleased", None),
        ("1.2.0", "2030-01-02"),
        ("1.1.0", None),
    ]
    assert [each.text for each in found] == ["", "### Added\n\n- Something new.", "- Older."]


def test_the_section_of_the_version_is_taken() -> None:
    assert section_of(CHANGELOG, "1.2.0", is_dry_run=False).date == "2030-01-02"


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
    assert section_of(changelog, "1.3.0", is_dry_run=True).text == "- To come."
    assert section_of(CHANGELOG, "1.2.0", is_dry_run=True).name == "1.2.0"
    assert section_of(CHANGELOG, "1.1.0", is_dry_run=True).text == "- Older."


def test_the_changelog_of_this_repository_can_be_read() -> None:
    assert sections((ROOT / "CHANGELOG.md").read_text())[0].text


def test_the_notes_hold_the_section_the_wheel_and_the_files() -> None:
    section = section_of(CHANGELOG, "1.2.0", is_dry_run=False)
    notes = release_notes(section, "1.2.0", ["polhode-1.2.0-py3-none-any.whl", "polhode-1.2.0.tar.gz"])
    assert notes.startswith(
        "# polhode 1.2.0, 2030-01-02\n\n### Added\n\n- Something new.\n\n## Installation\n"
    )
    assert "./polhode-1.2.0-py3-none-any.whl\n" in notes
    assert notes.endswith("- `polhode-1.2.0-py3-none-any.whl`\n- `polhode-1.2.0.tar.gz`\n")
