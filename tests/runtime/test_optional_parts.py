"""Optional parts: each is an extra of the package, and its messages name a command that exists."""

import re
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from polhode.runtime import optional_parts
from polhode.runtime.optional_parts import OPTIONAL_PARTS, missing_message, missing_part, part_with

ROOT = Path(__file__).parents[2]


def test_each_is_an_extra_that_brings_its_modules() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    distributions = packages_distributions()
    for part in OPTIONAL_PARTS:
        named = {re.split(r"[<>=]", requirement)[0].lower() for requirement in extras[part.extra]}
        for module in part.modules:
            found = {name.lower() for name in distributions.get(module, [module])}
            assert named & found, (part.extra, module)


def test_make_extras_installs_all_of_them() -> None:
    recipe = re.search(
        r"^extras:.*\n\t.*--editable '\.\[(.*)\]'", (ROOT / "Makefile").read_text(), re.MULTILINE
    )
    assert recipe is not None
    assert set(recipe[1].split(",")) >= {part.extra for part in OPTIONAL_PARTS}


def test_the_page_lists_them() -> None:
    page = (ROOT / "docs" / "command_line.md").read_text().replace("`", "")
    for part in OPTIONAL_PARTS:
        assert f"| {', '.join(part.modules.values())} | {part.extra} | {part.purpose} |" in page


def test_a_missing_one_is_named_with_the_command_that_is_right_for_the_installation(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(optional_parts, "find_spec", lambda name: None)
    assert part_with("gtsam").missing == ["Ceres", "GTSAM"]
    assert missing_message("gtsam") == missing_part("gtsam") == "GTSAM is not installed (make extras)"
    monkeypatch.setattr(optional_parts, "CHECKOUT", tmp_path / "Makefile")
    assert missing_message("av") == "PyAV is not installed (pip install 'polhode[import]')"
    monkeypatch.setattr(optional_parts, "find_spec", lambda name: name)
    assert part_with("gtsam").missing == [] and missing_part("gtsam") is None
    with pytest.raises(KeyError, match="numpy"):
        part_with("numpy")
