"""CITATION.cff holds to CFF 1.2.0, and states what the project states."""

import datetime
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

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


FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


@pytest.mark.parametrize("form", [each for each in FORMS if each.name != "config.yml"], ids=lambda f: f.stem)
def test_each_issue_form_can_be_shown(form: Path) -> None:
    """What GitHub requires: a name, a description, and elements with a label and an identifier of their own."""
    content = yaml.safe_load(form.read_text())
    assert content["name"] and content["description"]
    fields = [each for each in content["body"] if each["type"] != "markdown"]
    assert {each["type"] for each in fields} <= {"input", "textarea", "dropdown", "checkboxes"}
    names = [each["id"] for each in fields]
    assert len(set(names)) == len(names) and all(each["attributes"]["label"] for each in fields)
    assert any(each.get("validations", {}).get("required") for each in fields)


def test_reports_ask_for_the_installation_and_for_the_summary() -> None:
    asked = {
        form.stem: {
            each["id"]
            for each in yaml.safe_load(form.read_text()).get("body", [])
            if each.get("validations", {}).get("required")
        }
        for form in FORMS
    }
    assert {"command", "doctor"} <= asked["bug"]
    assert {"summary", "checkout", "doctor"} <= asked["wrong_answer"]
