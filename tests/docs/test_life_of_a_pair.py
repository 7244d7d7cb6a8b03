"""Functions that docs/life_of_a_pair.md names exist."""

import re

from tests.docs.page_code import ROOT


def test_functions_of_the_life_of_a_pair_are_in_the_files_that_it_names() -> None:
    page = (ROOT / "docs" / "life_of_a_pair.md").read_text()
    found = re.findall(r"((?:`\w+`(?:, )?)+) in \[`[\w.]+`\]\(\.\./([\w/.]+)\)", page)
    assert len(found) > 12
    for names, path in found:
        text = (ROOT / path).read_text()
        assert [name for name in re.findall(r"\w+", names) if f"def {name}(" not in text] == [], path
