"""What MkDocs calls while it builds: see ``hooks`` in mkdocs.yml."""

import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
# MkDocs loads this file by its path: the package, and the modules beside it, are imported from the checkout.
sys.path.insert(0, str(ROOT))

from website.generated import generated_pages  # noqa: E402
from website.mathematics import with_mathml  # noqa: E402
from website.source_pages import with_site_links  # noqa: E402

OTHER_PAGES = "How-to guides"
"""Section of the navigation that receives the pages which mkdocs.yml does not name."""


def on_config(config: MkDocsConfig) -> None:
    """Put pages that the navigation does not name where a reader looks first."""
    named = set(_paths(config.nav))
    others = sorted({path.name for path in Path(config.docs_dir).glob("*.md")} - named)
    section = next(entry[OTHER_PAGES] for entry in config.nav or [] if OTHER_PAGES in entry)
    section.extend(others)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from the code and from tables of studies."""
    for path, text in generated_pages(ROOT).items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to files of the repository lead to their pages in the site."""
    del config, files
    return with_site_links(markdown, page.file.src_uri)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write the mathematics as MathML, which browsers show without a script."""
    del config, files
    return with_mathml(html, page.file.src_uri)


def _paths(entries: Any) -> list[str]:
    """Paths that a part of the navigation names."""
    if isinstance(entries, str):
        return [entries]
    if isinstance(entries, dict):
        entries = list(entries.values())
    return [path for entry in entries or [] for path in _paths(entry)]
