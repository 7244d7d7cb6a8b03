"""The forms for issues can be shown, and ask for what an answer needs."""

from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


@pytest.mark.parametrize("form", [each for each in FORMS if each.name != "config.yml"], ids=lambda f: f.stem)
def test_each_issue_form_can_be_shown(form: Path) -> None:
    """What GitHub requires: a name, a description, and elements with labels and identifiers of their own."""
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
    assert {"command", "versions"} <= asked["bug"]
    assert {"summary", "checkout", "versions"} <= asked["wrong_answer"]
