"""Make a release: build, check, describe.

    make release                                  the version that the commit's tag names, into dist/
    make release OPTIONS=--dry-run                the last commit, with or without a tag, into dist/dry-run/
    make release OPTIONS="--dry-run --offline"    the same with the dependencies of .venv, in a minute

Files take their places when all checks have passed. Exit code 2: uncommitted changes, no tag, a tag that is
not the version of pyproject.toml, no section in the changelog; 1: the build or a check failed.
"""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from polhode.atomic import write_all
from polhode.errors import InputError, RunFailure, one_line
from release.distribution import build, check_distribution, export_commit, sha256sums
from release.notes import release_notes, section_of
from release.trial import make_environment, try_program
from release.version import candidate, require_cited_date

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = "constraints.txt"
BILL = "polhode.cdx.json"
NOTES = "RELEASE_NOTES.md"
SUMS = "SHA256SUMS"


def make_release(root: Path, output: Path, is_dry_run: bool, is_offline: bool) -> list[Path]:
    """All steps; returned are the files in ``output``. Raises InputError and RunFailure as their steps do."""
    chosen = candidate(root, is_dry_run)
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    section = section_of(changelog, chosen.version, is_dry_run)
    if section.date is not None and not is_dry_run:
        require_cited_date(root, section.date)
    with tempfile.TemporaryDirectory(prefix="polhode-release-") as name:
        work = Path(name)
        print(f"polhode {chosen.version} of commit {chosen.commit[:12]}", flush=True)
        source = export_commit(root, chosen.commit, work / "source")
        (work / "archives").mkdir()
        built = build(source, work / "archives", chosen.time_s)
        check_distribution(built, source, chosen.version)
        print("sdist and wheel are built; names, metadata and files are right", flush=True)
        constraints = None if is_offline else source / CONSTRAINTS
        environment = make_environment(work, built.wheel, constraints)
        try_program(environment, source / "sample", chosen.version)
        print("the wheel runs in an empty environment", flush=True)
        bill = work / BILL
        _bill_of_materials(bill)
        files = {
            each.name: each.read_bytes() for each in (built.sdist, built.wheel, bill, source / CONSTRAINTS)
        }
    files[NOTES] = release_notes(section, chosen.version, sorted(files)).encode("utf-8")
    files[SUMS] = sha256sums(files).encode("utf-8")
    output.mkdir(parents=True, exist_ok=True)
    placed = {output / name: content for name, content in files.items()}
    write_all(placed)
    return list(placed)


def _bill_of_materials(file: Path) -> None:
    """Write the bill. Raises InputError: its library is not installed."""
    try:
        from release.bill_of_materials import as_json, bill_of_materials
    except ModuleNotFoundError as missing:
        raise InputError(f"{missing.name} is not installed: make sbom installs it") from missing
    file.write_text(as_json(bill_of_materials()), encoding="utf-8")


def main(words: list[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m release", description="Build and check a release.")
    parser.add_argument(
        "--dry-run", action="store_true", help="no tag, changed files and no own section are fine"
    )
    parser.add_argument(
        "--offline",
        action="store_true",
        help="use the dependencies of this environment (with --dry-run only)",
    )
    parser.add_argument("-o", "--output", type=Path, help="default: dist, or dist/dry-run with --dry-run")
    given = parser.parse_args(words)
    output = given.output or ROOT / ("dist/dry-run" if given.dry_run else "dist")
    try:
        if given.offline and not given.dry_run:
            raise InputError("--offline tries the wheel in no empty environment: add --dry-run")
        if shutil.which("git") is None:
            raise InputError("git is not installed: a release is made of a commit")
        files = make_release(ROOT, output, given.dry_run, given.offline)
    except (InputError, RunFailure) as error:
        print(f"release: {one_line(str(error))}", file=sys.stderr)
        return error.exit_code
    for file in files:
        print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
