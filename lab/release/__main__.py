"""Make a release: build, check, describe.

    make release                                  the version that the commit's tag names, into dist/
    make release OPTIONS=--dry-run                the last commit, with or without a tag, into dist/dry-run/
    make release OPTIONS="--dry-run --offline"    the same with the dependencies of .venv, in a minute

Files take their places when all checks have passed. Exit code 2: uncommitted changes, no tag, a tag that is
not the version of pyproject.toml, no section in the changelog; 1: the build or a check failed.
"""

import argparse
import hashlib
import shutil
import sys
import tempfile
from pathlib import Path

from lab.release.distribution import build, check_distribution, export_commit
from lab.release.trial import make_environment, try_program
from lab.release.version import candidate, release_notes
from polhode.files.atomic import write_all
from polhode.runtime.errors import InputError, RunFailure, one_line

ROOT = Path(__file__).resolve().parents[2]


def make_release(root: Path, output: Path, is_dry_run: bool, is_offline: bool) -> list[Path]:
    """All steps; returned are the files in ``output``. Raises InputError and RunFailure as their steps do."""
    chosen = candidate(root, is_dry_run)
    with tempfile.TemporaryDirectory(prefix="polhode-release-") as name:
        work = Path(name)
        print(f"polhode {chosen.version} of commit {chosen.commit[:12]}", flush=True)
        source = export_commit(root, chosen.commit, work / "source")
        built = build(source, work / "archives", chosen.time_s)
        check_distribution(built, source, chosen.version)
        print("sdist and wheel are built; names, metadata and files are right", flush=True)
        constraints = source / "constraints.txt"
        environment = make_environment(work, built.wheel, None if is_offline else constraints)
        try_program(environment, source / "examples" / "sample", chosen.version)
        print("the wheel runs in an empty environment", flush=True)
        files = {each.name: each.read_bytes() for each in (built.sdist, built.wheel, constraints)}
    files["polhode.cdx.json"] = _bill_of_materials().encode()
    files["RELEASE_NOTES.md"] = release_notes(chosen, sorted(files)).encode()
    sums = (f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files))
    files["SHA256SUMS"] = "".join(sums).encode()
    output.mkdir(parents=True, exist_ok=True)
    write_all({output / name: content for name, content in files.items()})
    return [output / name for name in files]


def _bill_of_materials() -> str:
    """Its text. Raises InputError: its library is not installed."""
    try:
        from lab.release.bill_of_materials import as_json, bill_of_materials
    except ModuleNotFoundError as missing:
        raise InputError(f"{missing.name} is not installed: make sbom installs it") from missing
    return as_json(bill_of_materials())


def main(words: list[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m lab.release", description="Build and check a release.")
    parser.add_argument(
        "--dry-run", action="store_true", help="no tag, changed files and no own section are fine"
    )
    parser.add_argument("--offline", action="store_true", help="use the dependencies of this environment")
    parser.add_argument("-o", "--output", type=Path, help="default: dist, or dist/dry-run with --dry-run")
    given = parser.parse_args(words)
    try:
        if given.offline and not given.dry_run:
            raise InputError("--offline tries the wheel in no empty environment: add --dry-run")
        if shutil.which("git") is None:
            raise InputError("git is not installed: a release is made of a commit")
        output = given.output or ROOT / ("dist/dry-run" if given.dry_run else "dist")
        files = make_release(ROOT, output, given.dry_run, given.offline)
    except (InputError, RunFailure) as error:
        print(f"release: {one_line(str(error))}", file=sys.stderr)
        return error.exit_code
    print(*files, sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
