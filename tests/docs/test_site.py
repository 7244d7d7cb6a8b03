"""The site builds without a warning, which covers its links and anchors, and needs no network to be read."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from docs.website.mathematics import with_mathml
from docs.website.reference_pages import commands_page, help_of, settings_page
from docs.website.source_pages import with_site_links
from polhode.cli.main import COMMANDS
from polhode.config import Config
from polhode.config.keys import leaves
from tests.conftest import MakeOnce
from tests.docs.page_code import PAGES, README, ROOT


@pytest.fixture(scope="module")
def site(make_once: MakeOnce) -> Path:
    """That of POLHODE_SITE, which `.ci/run` has just built in the same way, or one that is built now."""
    built = os.environ.get("POLHODE_SITE")
    if built is not None:
        return Path(built)

    def build(folder: Path) -> None:
        words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
        environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
        done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    return make_once("site", build)


def test_every_page_is_in_the_navigation_and_the_search_and_studies_beside_their_tables(site: Path) -> None:
    pages = [page for page in PAGES if page != README]
    navigation = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    assert [page for page in pages if f" {page}\n" not in navigation] == []
    index = json.loads((site / "search" / "search_index.json").read_text())
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert {page.replace(".md", ".html") for page in pages if page != "index.md"} <= found
    # files of the repository are there, but would hide the pages in a search
    assert not any(location.startswith("source/") for location in found)
    assert (site / "source" / "polhode" / "pipeline" / "run.py.html").is_file()
    folders = sorted((ROOT / "docs" / "study_results").glob("*/"))
    assert folders
    for folder in folders:
        place = site / "study_results" / folder.name
        assert (place / "table.parquet").read_bytes() == (folder / "table.parquet").read_bytes()
        assert " points" in (place / "study.html").read_text()


def test_pages_load_nothing_from_a_network_and_hold_no_latex(site: Path) -> None:
    loading = re.compile(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=[\"']?(?:https?:)?//[^\"'> ]+")
    for page in sorted(site.rglob("*.html")):
        text = page.read_text()
        assert [each[0] for each in loading.finditer(text) if 'rel="canonical"' not in each[0]] == [], page
        assert 'class="arithmatex"' not in text, page
    assert "<math" in (site / "mathematics.html").read_text()


def test_formulas_and_links_are_converted() -> None:
    shown = with_mathml(r'<span class="arithmatex">\(J \dot w\)</span>', "a.md")
    assert shown.startswith("<math") and r"\dot" not in shown
    with pytest.raises(ValueError, match=r"a\.md: the formula"):
        with_mathml(r'<span class="arithmatex">\(\nocommand a\)</span>', "a.md")
    text = "[a](../backend/estimate.py) [b](backend.md#the-problem) [c](https://a.b/c) [d](../CHANGELOG.md)"
    assert with_site_links(text, "live.md") == (
        "[a](source/backend/estimate.py.md) [b](backend.md#the-problem) [c](https://a.b/c) [d](changelog.md)"
    )
    assert with_site_links("[a](docs/api.md)", "readme.md") == "[a](api.md)"


def test_the_reference_has_every_command_and_every_setting() -> None:
    commands, settings = commands_page(), settings_page()
    assert [name for name in COMMANDS if f"\n## {name}\n" not in commands] == []
    assert help_of("predict").splitlines()[0] in commands
    for path, _ in leaves(Config):
        assert f"| `{path[-1]}` |" in settings, path
        assert len(path) == 1 or f"\n## {'.'.join(path[:-1])}\n" in settings, path
