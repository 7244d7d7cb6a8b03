"""Files of the repository that pages link to: their paths in the site, and pages that show them.

The site can be read without a network and without a checkout, so that a link to ``../backend/estimate.py``
leads to a page with the text of that file.
"""

import ast
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

PROJECT_PAGES = {
    "README.md": "readme.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security_policy.md",
    "CODE_OF_CONDUCT.md": "code_of_conduct.md",
}
"""Pages at the top level of the repository, and their paths in the site."""

_LINK = re.compile(r"(?P<head>\]\()(?P<target>[^)\s#]+)(?P<anchor>#[^)\s]*)?(?P<tail>\))")
_LANGUAGES = {".py": "python", ".yaml": "yaml", ".json": "json", ".cpp": "cpp", ".md": "markdown"}
_HIDDEN_FROM_SEARCH = "---\nsearch:\n  exclude: true\nhide:\n  - toc\n---\n\n"


def with_site_links(markdown: str, page: str) -> str:
    """The text of a page, by its path in the site, with links that lead to pages of the site."""
    if page.startswith("source/"):
        return markdown
    originals = {site: original for original, site in PROJECT_PAGES.items()}
    here = originals.get(page, f"docs/{page}")

    def rewritten(match: re.Match[str]) -> str:
        target = match["target"]
        if "://" in target or target.startswith("mailto:"):
            return match[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(here), target))
        link = posixpath.relpath(site_path(path), posixpath.dirname(page) or ".")
        return f"{match['head']}{link}{match['anchor'] or ''}{match['tail']}"

    return _LINK.sub(rewritten, markdown)


def site_path(path: str) -> str:
    """Path in the site of a file or folder of the repository."""
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    return PROJECT_PAGES.get(path, f"source/{path}.md")


def linked_files(root: Path) -> set[str]:
    """Files and folders outside docs/ that the pages and the project pages link to."""
    pages = {f"docs/{path.name}": path for path in (root / "docs").glob("*.md")}
    pages |= {name: root / name for name in PROJECT_PAGES}
    found = set()
    for name, file in pages.items():
        for match in _LINK.finditer(file.read_text()):
            if "://" not in match["target"]:
                found.add(posixpath.normpath(posixpath.join(posixpath.dirname(name), match["target"])))
    found = {path for path in found if (root / path).exists()}
    return {path for path in found if not path.startswith("docs/") and path not in PROJECT_PAGES}


def source_pages(root: Path) -> Iterator[tuple[str, str]]:
    """Paths and texts of the pages that show linked files, and of the project pages."""
    for path in sorted(linked_files(root)):
        file = root / path
        if file.is_dir():
            package, names = file / "__init__.py", sorted(entry.name for entry in file.iterdir())
            said = ast.get_docstring(ast.parse(package.read_text())) if package.is_file() else ""
            listed = ", ".join(f"`{name}`" for name in names if name[0] not in "._")
            shown = f"```text\n{said}\n```\n\nFiles: {listed}"
        else:
            language = _LANGUAGES.get(file.suffix, "text")
            shown = f"``````{language}\n{file.read_text().rstrip()}\n``````"
        yield site_path(path), f"{_HIDDEN_FROM_SEARCH}# {path}\n\n{shown}\n"
    for original, site in PROJECT_PAGES.items():
        yield site, (root / original).read_text()
