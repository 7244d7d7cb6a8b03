"""Make a release: build, check, try, describe.

    make release                                  the version that the commit's tag names, into dist/
    make release OPTIONS=--dry-run                the last commit, with or without a tag, into dist/dry-run/
    make release OPTIONS="--dry-run --offline"    the same with the dependencies of .venv, in a minute

Files take their places when all checks have passed. Exit code 2: uncommitted changes, no tag, a tag that is
not the version of pyproject.toml, no section in the changelog; 1: the build or a check failed.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import yaml
from packaging.metadata import Metadata
from trove_classifiers import classifiers

from lab.command import ROOT
from polhode.files.atomic import write_all
from polhode.runtime.errors import InputError, RunFailure, one_line

HEADING = re.compile(r"^## \[(?P<name>[^\]]+)\](?: - (?P<date>\d{4}-\d{2}-\d{2}))?[ \t]*$", re.MULTILINE)
PAIRS = 8
"""Of the sample, on which the wheel is tried"""
LIGHT = (
    *("--backend.window.enabled", "False", "--frontend.depth.method", "sgbm"),
    *("--mapping.voxel-mm", "10"),
)
"""Options that make a run of a few frames short."""
NOTES = """# polhode {version}{date}

{changes}

## Installation

```
sha256sum --check --ignore-missing SHA256SUMS
python -m pip install --constraint constraints.txt ./{wheel}
```

`constraints.txt` pins the versions of all dependencies that this release was tested with.

## Files

{files}
"""


@dataclass(frozen=True)
class Candidate:
    """A commit and the version that it states."""

    commit: str
    version: str
    time_s: str
    """Of the commit [s since 1970]: the date of the files in the archives"""
    changes: str
    """The changelog's section of the version"""
    date: str | None
    """Of the release, YYYY-MM-DD"""


def make_release(output: Path, is_dry_run: bool, is_offline: bool) -> list[Path]:
    """All steps; returned are the files in ``output``. Raises InputError and RunFailure as their steps do."""
    chosen = candidate(is_dry_run)
    with tempfile.TemporaryDirectory(prefix="polhode-release-") as name:
        work = Path(name)
        print(f"polhode {chosen.version} of commit {chosen.commit[:12]}", flush=True)
        archive = work / "source.tar"
        call(ROOT, "git", "archive", "--format=tar", f"--output={archive}", chosen.commit)
        # Of our own making; Python 3.11.2 of Debian 12 has no filters of tarfile yet.
        shutil.unpack_archive(archive, work / "source")
        sdist, wheel = build(work / "source", work / "archives", chosen.time_s)
        check_wheel(wheel, work / "source", chosen.version)
        print("sdist and wheel are built; names, metadata and files are right", flush=True)
        try_wheel(wheel, work, chosen.version, is_offline)
        print("the wheel runs in an empty environment", flush=True)
        files = {each.name: each.read_bytes() for each in (sdist, wheel, work / "source" / "constraints.txt")}
    files["polhode.cdx.json"] = _bill_of_materials().encode()
    files["RELEASE_NOTES.md"] = NOTES.format(
        version=chosen.version,
        date=f", {chosen.date}" if chosen.date else "",
        changes=chosen.changes,
        wheel=wheel.name,
        files="\n".join(f"- `{name}`" for name in sorted(files)),
    ).encode()
    sums = (f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files))
    files["SHA256SUMS"] = "".join(sums).encode()
    output.mkdir(parents=True, exist_ok=True)
    write_all({output / name: content for name, content in files.items()})
    return [output / name for name in files]


def candidate(is_dry_run: bool) -> Candidate:
    """The commit to release; a dry run takes any commit, and what is unreleased.

    Raises InputError: no checkout, versions that differ, or no section in the changelog; without
    ``is_dry_run`` also uncommitted files, a missing or different tag, a date that is missing or differs.
    """
    version = str(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    changelog = (ROOT / "CHANGELOG.md").read_text()
    try:
        commit, time_s = call(ROOT, "git", "log", "-1", "--format=%H %ct").split()
    except RunFailure as failure:
        raise InputError(f"{ROOT} is no checkout with a commit: {failure}") from failure
    _require(
        cited.get("version") == version, f"the versions of CITATION.cff and pyproject.toml ({version}) differ"
    )
    heads = list(HEADING.finditer(changelog))
    name = "Unreleased" if is_dry_run and version not in {each["name"] for each in heads} else version
    found = next((n for n, each in enumerate(heads) if each["name"] == name), None)
    title = f"## [{version}] - YYYY-MM-DD"
    if found is None:
        raise InputError(f"CHANGELOG.md has no section '{title}': give what is under [Unreleased] this title")
    end = heads[found + 1].start() if found + 1 < len(heads) else len(changelog)
    text, date = changelog[heads[found].end() : end].strip(), heads[found]["date"]
    _require(bool(text), f"CHANGELOG.md has nothing under [{name}]: say there what the release changes")
    if not is_dry_run:
        changed = call(ROOT, "git", "status", "--porcelain").splitlines()
        _require(
            not changed, f"the working tree has {len(changed)} uncommitted changes: commit or remove them"
        )
        tags = re.findall(r"^v\d\S*$", call(ROOT, "git", "tag", "--points-at", "HEAD"), re.MULTILINE)
        how = f"git tag -a v{version} -m v{version}; or try without one: make release OPTIONS=--dry-run"
        _require(tags == [f"v{version}"], f"the commit's tags are {tags or 'none'}, not v{version}: {how}")
        _require(date is not None, f"CHANGELOG.md has no date beside [{version}]: write '{title}'")
        released = str(cited.get("date-released"))
        _require(released == date, f"CITATION.cff has the date {released}, the changelog {date}")
    return Candidate(commit, version, time_s, text, date)


def build(source: Path, folder: Path, time_s: str) -> tuple[Path, Path]:
    """The sdist of ``source``, and the wheel of that sdist, both in ``folder``. Raises RunFailure."""
    environment = own_environment() | {"SOURCE_DATE_EPOCH": time_s}
    command = (sys.executable, "-m", "hatchling", "build", "-d", folder, "-t")
    call(source, *command, "sdist", environment=environment)
    sdist = next(folder.glob("polhode-*.tar.gz"))
    shutil.unpack_archive(sdist, folder / "unpacked")
    call(next((folder / "unpacked").iterdir()), *command, "wheel", environment=environment)
    return sdist, next(folder.glob("polhode-*.whl"))


def check_wheel(wheel: Path, source: Path, version: str) -> None:
    """Compare its metadata and files with the ``source``. Raises RunFailure: the first fault."""
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        metadata = archive.read(next(name for name in names if name.endswith(".dist-info/METADATA")))
    # links are followed: three rooms stand beside the package
    linked = ((source / each, f"polhode/{each}") for each in ("backend", "frontend", "train"))
    folders = [(source / "polhode", "polhode"), *linked]
    expected = {
        f"{name}/{path.relative_to(folder)}"
        for folder, name in folders
        for path in folder.rglob("*")
        if path.is_file()
    }
    own = {name for name in names if ".dist-info/" not in name}
    faults = [f"{name} is in one of wheel and source only" for name in sorted(own ^ expected)]
    try:
        parsed = Metadata.from_email(metadata, validate=True)
    except ExceptionGroup as group:
        faults += [str(each) for each in group.exceptions]
    else:
        if (parsed.name, str(parsed.version)) != ("polhode", version):
            faults.append(f"it is {parsed.name} {parsed.version} instead of polhode {version}")
        faults += [
            f"unknown classifier '{each}'" for each in parsed.classifiers or [] if each not in classifiers
        ]
        fields = ("description", "summary", "license_files", "requires_python", "requires_dist")
        faults += [f"{field} is missing" for field in fields if not getattr(parsed, field)]
    if faults:
        raise RunFailure(f"the distribution is wrong in {len(faults)} ways; the first: {faults[0]}")


def try_wheel(wheel: Path, folder: Path, version: str, is_offline: bool) -> None:
    """Install the wheel into an empty environment; version, help, and a run on a few pairs of the sample.

    Offline, the dependencies of this environment are used and nothing is downloaded. Raises RunFailure.
    """
    python, work = folder / "environment" / "bin" / "python", folder / "work"
    call(folder, sys.executable, "-m", "venv", "--without-pip", folder / "environment")
    pip = (sys.executable, "-m", "pip", "--python", python)
    install = (*pip, "install", "--quiet", "--disable-pip-version-check", "--no-compile")
    if is_offline:
        call(folder, *install, "--no-deps", "--no-index", wheel)
        packages = next((folder / "environment" / "lib").iterdir()) / "site-packages"
        # An editable installation there is not seen, because its own .pth is not read.
        (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    else:
        call(folder, *install, "--constraint", folder / "source" / "constraints.txt", wheel)
        call(folder, *pip, "check")
    (folder / "home").mkdir()
    work.mkdir()
    environment = {"HOME": str(folder / "home"), "PATH": f"{python.parent}:{os.defpath}", "LANG": "C.UTF-8"}

    def run(*words: str | Path) -> str:
        return call(work, *words, environment=environment)

    printed = run("polhode", "--version").strip()
    sample = folder / "source" / "examples" / "sample"
    run("polhode", "import", sample, "-o", "sequence", "--end", str(_seconds_of_pairs(sample)))
    run("polhode", "run", "--data", "sequence", "-o", "result", *LIGHT)
    frames = json.loads((work / "result" / "summary.json").read_text(encoding="utf-8"))["frames"]
    names = ("report.html", "trajectory.csv", "mesh.ply")
    missing = [name for name in names if not (work / "result" / name).is_file()]
    if printed != f"polhode {version}" or frames != PAIRS or missing:
        raise RunFailure(
            f"in the empty environment: {printed}, {frames} of {PAIRS} frames, missing: {missing}"
        )


def _seconds_of_pairs(sequence: Path) -> float:
    """The time of the last of PAIRS pairs since the first [s]."""
    lines = (sequence / "mav0" / "cam0" / "data.csv").read_text().splitlines()[1 : PAIRS + 1]
    stamps = [int(line.partition(",")[0]) for line in lines]
    return (stamps[-1] - stamps[0]) / 1e9 + 1e-3


def call(folder: Path, *command: str | Path, environment: dict[str, str] | None = None) -> str:
    """What ``command`` prints on standard output when it runs in ``folder``.

    Without an ``environment`` it gets ours, but for the variables that change which modules Python finds.
    Raises RunFailure: the program is missing or failed; the line holds the last one of its errors.
    """
    words = [str(word) for word in command]
    given = own_environment() if environment is None else environment
    try:
        done = subprocess.run(words, cwd=folder, env=given, capture_output=True, text=True, check=False)
    except OSError as error:
        raise RunFailure(f"{words[0]} cannot be started: {error.strerror}") from error
    if done.returncode != 0:
        last = (done.stderr.strip() or done.stdout.strip() or "nothing was printed").splitlines()[-1]
        raise RunFailure(f"'{' '.join(words)}' ended with exit code {done.returncode}: {last}")
    return done.stdout


def own_environment() -> dict[str, str]:
    """Our environment variables without Python's own."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise InputError(fault)


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
        _require(
            given.dry_run or not given.offline,
            "--offline tries the wheel in no empty environment: add --dry-run",
        )
        output = given.output or ROOT / ("dist/dry-run" if given.dry_run else "dist")
        files = make_release(output, given.dry_run, given.offline)
    except (InputError, RunFailure) as error:
        print(f"release: {one_line(str(error))}", file=sys.stderr)
        return error.exit_code
    print(*files, sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
