"""The site builds without a warning, which covers its links and anchors, and needs no network to be read."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from polhode.api import load_study
from polhode.cli.main import COMMANDS
from polhode.config import Config
from polhode.config.keys import leaves
from tests.conftest import MakeOnce
from tests.docs.page_code import PAGES, ROOT
from website.benchmarks_page import benchmarks_page
from website.commands_page import commands_page, help_of
from website.configuration_page import configuration_page
from website.external_links import addresses
from website.mathematics import with_mathml
from website.source_pages import site_path, with_site_links


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


def test_every_page_is_in_the_site_and_in_its_search(site: Path) -> None:
    for page in PAGES:
        assert (site / page).with_suffix(".html").is_file()
    index = json.loads((site / "search" / "search_index.json").read_text())
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert {page.replace(".md", ".html") for page in PAGES if page != "index.md"} <= found
    # files of the repository are there, but would hide the pages in a search
    assert not any(location.startswith("source/") for location in found)
    assert (site / "source" / "pipeline" / "run.py.html").is_file()


def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    loading = re.compile(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=[\"']?(?:https?:)?//[^\"'> ]+")
    for page in sorted(site.rglob("*.html")):
        loaded = [
            match[0] for match in loading.finditer(page.read_text()) if 'rel="canonical"' not in match[0]
        ]
        assert loaded == [], page


def test_no_formula_is_left_as_latex(site: Path) -> None:
    for page in sorted(site.glob("*.html")):
        assert 'class="arithmatex"' not in page.read_text(), page
    assert "<math" in (site / "observability.html").read_text()


def test_a_formula_that_cannot_be_converted_is_an_error_that_names_the_page() -> None:
    shown = with_mathml(r'<span class="arithmatex">\(J \dot w\)</span>', "a.md")
    assert shown.startswith("<math") and r"\dot" not in shown
    with pytest.raises(ValueError, match=r"a\.md: the formula"):
        with_mathml(r'<span class="arithmatex">\(\nocommand a\)</span>', "a.md")


def test_the_reference_has_every_command_and_every_setting() -> None:
    commands = commands_page()
    for name in COMMANDS:
        assert f"\n## {name}\n" in commands
    assert help_of("predict").splitlines()[0] in commands
    settings = configuration_page()
    for path, _ in leaves(Config):
        assert f"| `{path[-1]}` |" in settings, path
        assert len(path) == 1 or f"\n## {'.'.join(path[:-1])}\n" in settings, path


def test_the_page_of_the_benchmarks_has_commands_and_days() -> None:
    page = benchmarks_page(ROOT)
    row = next(line for line in page.splitlines() if line.startswith("| `trust` |"))
    assert "`python -m benchmarks.trust.trust`" in row
    assert re.search(r"\| \d{4}-\d\d-\d\d \(record\) \|", row)


def test_links_to_files_lead_to_pages_of_the_site() -> None:
    assert site_path("docs/backend.md") == "backend.md"
    assert site_path("README.md") == "readme.md"
    text = "[a](../backend/estimate.py) [b](backend.md#the-problem) [c](https://a.b/c) [d](../CHANGELOG.md)"
    assert with_site_links(text, "window.md") == (
        "[a](source/backend/estimate.py.md) [b](backend.md#the-problem) [c](https://a.b/c) [d](changelog.md)"
    )
    assert with_site_links("[a](docs/api.md)", "readme.md") == "[a](api.md)"


def test_addresses_end_where_the_text_goes_on(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("See [it](https://a.b/c), https://d.e/f. And <https://g.h>")
    assert set(addresses([tmp_path / "a.md"])) == {"https://a.b/c", "https://d.e/f", "https://g.h"}


STUDIES = sorted((ROOT / "docs" / "study_results").glob("*/"))


def test_studies_have_their_pages_beside_their_tables(site: Path) -> None:
    assert STUDIES
    linked = (site / "studies.html").read_text()
    for folder in STUDIES:
        place = site / "study_results" / folder.name
        assert (place / "table.parquet").read_bytes() == (folder / "table.parquet").read_bytes()
        table = load_study(folder)
        assert f"{len(table)} points" in (place / "study.html").read_text()
        assert f"study_results/{folder.name}/study.html" in linked
