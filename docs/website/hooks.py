"""What MkDocs calls while it builds: see ``hooks`` in mkdocs.yml."""

import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
# MkDocs loads this file by its path: the package, and the modules beside it, are imported from the checkout.
sys.path.insert(0, str(ROOT))

from docs.website import reference_pages  # noqa: E402
from docs.website.mathematics import with_mathml  # noqa: E402
from docs.website.source_pages import source_pages, with_site_links  # noqa: E402
from polhode.studies.page.write_page import MAX_ROWS, render  # noqa: E402
from polhode.studies.study import open_study  # noqa: E402
from polhode.studies.table import PAGE, read_table  # noqa: E402


def generated_pages() -> dict[str, str]:
    """Path in the site -> Markdown, or HTML where the path says so."""
    pages = {
        "reference/commands.md": reference_pages.commands_page(),
        "reference/configuration.md": reference_pages.settings_page(),
        "reference/summary.md": reference_pages.summary_page(),
        "reference/benchmarks.md": reference_pages.benchmarks_page(),
        "reference/api.md": reference_pages.API,
        **dict(source_pages(ROOT)),
    }
    for folder in sorted((ROOT / "docs" / "study_results").glob("*/")):
        study = open_study(folder / "study.yaml", check=False)
        pages[f"study_results/{folder.name}/{PAGE}"] = render(study, read_table(folder, MAX_ROWS), folder)
    return pages


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from the code and from tables of studies."""
    for path, text in generated_pages().items():
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
