"""The pages of the studies whose tables are in docs/study_results, as `polhode sweep` would write them."""

from pathlib import Path

from polhode.studies.page.write_page import MAX_ROWS, render
from polhode.studies.study import open_study
from polhode.studies.table import PAGE, read_table


def study_pages(root: Path) -> dict[str, str]:
    """Path in the site -> HTML; root: the checkout."""
    return {
        f"study_results/{folder.name}/{PAGE}": render(
            open_study(folder / "study.yaml", check=False), read_table(folder, MAX_ROWS), folder
        )
        for folder in sorted((root / "docs" / "study_results").glob("*/"))
    }
