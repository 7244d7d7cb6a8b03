"""The two archives of a commit, source (sdist) and wheel, and what they must hold.

They are made from what the commit holds, whatever else lies in the checkout, and the wheel from the unpacked
sdist, so that both are complete. Files in them have the time of the commit: the same commit and build backend
give the same bytes.
"""

import shutil
import sys
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from packaging.metadata import Metadata
from trove_classifiers import classifiers

from lab.release.commands import call, own_environment
from polhode.runtime.errors import RunFailure

PACKAGE = "polhode"
"""The name of the project, and of its package, some rooms of which are links"""


@dataclass(frozen=True)
class Distribution:
    """The two archives."""

    sdist: Path
    wheel: Path


def export_commit(root: Path, commit: str, folder: Path) -> Path:
    """The files of a commit, unpacked into ``folder``; returned is that folder."""
    archive = folder.with_suffix(".tar")
    call(root, "git", "archive", "--format=tar", f"--output={archive}", commit)
    # Of our own making; Python 3.11.2 of Debian 12 has no filters of tarfile yet.
    shutil.unpack_archive(archive, folder)
    return folder


def build(source: Path, folder: Path, time_s: int | None = None) -> Distribution:
    """Build the sdist of ``source``, and the wheel of that sdist, into ``folder``.

    ``time_s`` is the time of the files in the archives [s since 1970]; by default the backend's own.
    Raises RunFailure: the backend refuses.
    """
    folder.mkdir(exist_ok=True)
    environment = own_environment()
    if time_s is not None:
        environment["SOURCE_DATE_EPOCH"] = str(time_s)
    command = (sys.executable, "-m", "hatchling", "build", "-d", folder, "-t")
    call(source, *command, "sdist", environment=environment)
    sdist = next(folder.glob(f"{PACKAGE}-*.tar.gz"))
    shutil.unpack_archive(sdist, folder / "unpacked")
    unpacked = folder / "unpacked" / sdist.name.removesuffix(".tar.gz")
    call(unpacked, *command, "wheel", environment=environment)
    shutil.rmtree(folder / "unpacked")
    return Distribution(sdist, next(folder.glob(f"{PACKAGE}-*.whl")))


def check_distribution(built: Distribution, source: Path, version: str) -> None:
    """Compare names, metadata and files of the archives with the ``source`` they were made of.

    Raises RunFailure: a line with the first fault and how many there are.
    """
    with zipfile.ZipFile(built.wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        metadata = archive.read(next(name for name in names if name.endswith(".dist-info/METADATA")))
    with tarfile.open(built.sdist) as sdist:
        stream = sdist.extractfile(f"{built.sdist.name.removesuffix('.tar.gz')}/PKG-INFO")
        info = stream.read() if stream is not None else b""
    own = {name for name in names if ".dist-info/" not in name}
    expected = packaged_files(source)
    faults = [
        *metadata_faults(metadata, version),
        *metadata_faults(info, version),
        *(f"{name} is not in the wheel" for name in sorted(expected - own)),
        *(f"{name} is in the wheel and not in the source" for name in sorted(own - expected)),
    ]
    if faults:
        raise RunFailure(f"the distribution is wrong in {len(faults)} ways; the first: {faults[0]}")


def metadata_faults(metadata: bytes, version: str) -> list[str]:
    """What is wrong with core metadata (METADATA or PKG-INFO), by the rules of the package index."""
    try:
        parsed = Metadata.from_email(metadata, validate=True)
    except ExceptionGroup as group:
        return [str(each) for each in group.exceptions]
    faults = []
    if (parsed.name, str(parsed.version)) != (PACKAGE, version):
        faults.append(f"it is {parsed.name} {parsed.version} instead of {PACKAGE} {version}")
    if not (parsed.description_content_type or "").startswith("text/markdown"):
        faults.append("Description-Content-Type is not text/markdown")
    for field in ("description", "summary", "license_files", "requires_python", "requires_dist"):
        if not str(getattr(parsed, field) or "").strip():
            faults.append(f"{field} is missing")
    return faults + [
        f"unknown classifier '{each}'" for each in parsed.classifiers or [] if each not in classifiers
    ]


def packaged_files(source: Path) -> set[str]:
    """The files of the package, links followed, by their names in the wheel; ``source`` is an export."""
    found, waiting = set(), [(source / PACKAGE, PACKAGE)]
    while waiting:
        folder, name = waiting.pop()
        for path in folder.iterdir():
            if path.is_dir():
                waiting.append((path.resolve(), f"{name}/{path.name}"))
            else:
                found.add(f"{name}/{path.name}")
    return found
