"""CITATION.cff holds to CFF 1.2.0, and states what the project states."""

import datetime
import tomllib
from pathlib import Path
from typing import Any

import pytest

from release.version import citation

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def cited() -> dict[str, Any]:
    return citation(ROOT)


def test_it_has_what_the_format_requires(cited: dict[str, Any]) -> None:
    assert cited["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "abstract", "date-released", "version"} <= cited.keys()
    assert cited["authors"] == [{"name": "The polhode developers"}]
    assert type(cited["date-released"]) is datetime.date


def test_its_licence_is_that_of_the_project(cited: dict[str, Any]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert cited["license"] == project["license"]


def test_each_reference_can_be_found_by_its_authors_title_and_year(cited: dict[str, Any]) -> None:
    found = [
        (each["type"], each["year"], [author["family-names"] for author in each["authors"]])
        for each in cited["references"]
    ]
    assert found == [("thesis", 2013, ["Tweddle"]), ("slides", 2012, ["Eaton", "Naasz"])]
    assert all(each["title"] and each["institution"]["name"] for each in cited["references"])
