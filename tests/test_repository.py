"""The repository as a package: our own modules are the ones imported, and what they import is declared."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "polhode"
LINKED = ("backend", "frontend", "train")
"""Rooms at the top level that are imported as ``polhode.ROOM``, by way of a link."""
ROOMS = tuple(sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py")))


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def modules() -> list[Path]:
    return [path for folder in ("polhode", *LINKED) for path in sorted((ROOT / folder).rglob("*.py"))]


def test_three_rooms_are_reached_by_a_relative_link() -> None:
    links = {path.name: path.readlink() for path in PACKAGE.iterdir() if path.is_symlink()}
    assert links == {name: Path("..") / name for name in LINKED}


@pytest.mark.parametrize("name", ["polhode", *(f"polhode.{room}" for room in ROOMS)])
def test_our_own_packages_are_the_ones_imported(name: str) -> None:
    found = importlib.import_module(name).__file__
    assert found is not None
    assert Path(found).resolve().parent == ROOT.joinpath(*name.split(".")).resolve()


def test_rooms_are_imported_by_their_full_name() -> None:
    """``import frontend`` works in the checkout only, and would be a second copy of the room."""
    python = [
        path for folder in ("tests", "lab", "examples", "docs") for path in (ROOT / folder).rglob("*.py")
    ]
    bare = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in [*modules(), *python]
        for name in imported_names(path) & set(LINKED)
    }
    assert bare == set()


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[\s<>=!~;\[]", name, maxsplit=1)[0]).lower()


@cache
def imported_names(path: Path) -> set[str]:
    """Top-level names of everything that a module imports, also inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names - set(sys.stdlib_module_names) - {"polhode"}


BROUGHT = ("train", "solvers", "export", "import", "pandas", "view")
"""Extras that parts of the program need."""


def test_every_import_is_a_declared_dependency() -> None:
    groups = project()["project"]
    # What the extra `train` brings is imported inside functions, which say so when it is missing.
    extras = groups["optional-dependencies"]
    # So is what `solvers` brings, by adapters that run only where it is there; what `export` brings: without
    # it there is another way; and what `import`, `pandas` and `view` bring.
    requirements = [*groups["dependencies"], *(each for name in BROUGHT for each in extras[name])]
    declared = {normalised(requirement) for requirement in requirements}
    distributions = packages_distributions()
    undeclared = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in modules()
        for name in imported_names(path)
        if not {normalised(each) for each in distributions.get(name, [name])} & declared
    }
    assert undeclared == set()


def test_every_declared_dependency_has_a_tested_version() -> None:
    groups = project()["project"]
    extras = groups["optional-dependencies"]
    installed = (
        *("dev", "peers", "solvers", "export", "formats", "sbom", "import", "view", "docs", "browser"),
        *("notebook", "pandas"),
    )
    wanted = groups["dependencies"] + [each for name in installed for each in extras[name]]
    declared = {normalised(each) for each in wanted}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    tested = {normalised(line) for line in lines if line and not line.startswith("#")}
    assert declared - tested == set()
    assert all("==" in line and "+" not in line for line in lines if line and not line.startswith("#"))


def test_no_package_of_tests_shadows_ours() -> None:
    # `tests/frontend/__init__.py` without `tests/__init__.py` would be imported as `frontend`.
    assert list((ROOT / "tests").rglob("__init__.py")) == []


@cache
def sources() -> list[str]:
    """All Python files, relative to the repository."""
    return [
        f"/{path.relative_to(ROOT)}" for each in FOLDERS.split("|") for path in (ROOT / each).rglob("*.py")
    ]


PAGES = (
    "CODE_OF_CONDUCT.md",
    "CONTRIBUTING.md",
    "README.md",
    "SECURITY.md",
    *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").glob("*.md")),
)
FOLDERS = "|".join((*LINKED, "polhode", "lab", "configs", "docs", "examples", "tests"))
GENERATED = re.compile(r"reference/|study_results/\w+/study\.html")
"""Pages that the site makes from the code and from the tables of studies; MkDocs checks the links to them."""


@pytest.mark.parametrize("page", PAGES)
def test_files_and_modules_that_a_page_names_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    links = {each.partition("#")[0] for each in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in each}
    links = {each for each in links if not GENERATED.match(each)}
    missing = {each for each in links if not (ROOT / page).parent.joinpath(each).exists()}
    for name, anchor in re.findall(r"\]\(([^)\s:]*)#([^)\s]+)\)", text):
        if GENERATED.match(name):
            continue
        titles = re.findall(
            r"^#+ (.*)$", ((ROOT / page).parent / name if name else ROOT / page).read_text(), re.M
        )
        if anchor not in {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}:
            missing.add(f"{name}#{anchor}")
    paths = set(re.findall(rf"(?<![\w./-])((?:{FOLDERS})/[\w./-]*\.[a-z]\w*)", text))
    missing |= {each for each in paths if not (ROOT / each).exists()}
    files = set(re.findall(r"`([\w./]+\.py)`", text))
    missing |= {each for each in files if not any(path.endswith(f"/{each}") for path in sources())}
    # A link whose text is a file leads to that file.
    named = re.findall(r"\[`([\w./]+\.py)`\]\(([^)\s]+)\)", text)
    missing |= {f"{name} -> {target}" for name, target in named if not f"/{target}".endswith(f"/{name}")}
    modules = {each.replace(".", "/") for each in re.findall(rf"python3? -m ((?:{FOLDERS})[\w.]*\w)", text)}
    for module in modules:
        if not (ROOT / f"{module}.py").is_file() and not (ROOT / module / "__init__.py").is_file():
            missing.add(module)
    assert missing == set()


def test_the_page_about_the_architecture_lists_every_sub_room() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text()
    rows = dict(re.findall(r"^\| `(?:polhode/)?(\w+)/` \| (.*)", text, re.MULTILINE))
    missing = {
        f"{path.parts[-3]}/{path.parts[-2]}"
        for path in PACKAGE.glob("*/*/__init__.py")
        if f"`{path.parts[-2]}/`" not in rows.get(path.parts[-3], "")
    }
    assert missing == set()


def test_make_help_lists_every_target() -> None:
    text = (ROOT / "Makefile").read_text()
    phony = re.search(r"^\.PHONY: (.*)$", text, re.MULTILINE)
    assert phony is not None
    done = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True)
    listed = re.findall(r"^make ([\w-]+)", done.stdout, re.MULTILINE)
    assert listed[0] == "help" and set(phony[1].split()) <= set(listed)


def test_what_tests_and_site_need_comes_with_one_installation() -> None:
    """The guards of the later ones read in the stamp of the first what came with it."""
    done = subprocess.run(
        ["make", "--always-make", "--dry-run", "setup-tests", "docs"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    lines = done.stdout.replace("\\\n", " ").splitlines()
    (extras, *others) = [
        re.findall(r"--editable '\.\[(.*)\]'", line)[0] for line in lines if "--editable" in line
    ]
    assert f"echo '[{extras}]' > .venv/.installed" in lines
    assert len(others) == 2 and all(each in extras for each in others)
    guarded = [line for line in lines if "--editable" in line and line.startswith("grep -qs")]
    assert len(guarded) == len(others)
