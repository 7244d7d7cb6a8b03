"""The two archives of a commit, source (sdist) and wheel, and what they must hold.

They are made from what the commit holds, whatever else lies in the checkout, and the wheel from the unpacked
sdist, so that both are complete. Files in them have the time of the commit: the same commit and build backend
give the same bytes.
"""

import base64
import csv
import hashlib
import io
import re
import shutil
import sys
import tarfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from email.parser import BytesParser
from pathlib import Path

from packaging.metadata import Metadata
from trove_classifiers import classifiers

from polhode.errors import RunFailure
from release.commands import call, own_environment

PACKAGE = "polhode"
"""The name of the project, of its package, and of the folder whose links lead to the rooms"""


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
    faults = [
        *metadata_faults(_metadata_of_wheel(built.wheel), version),
        *metadata_faults(_metadata_of_sdist(built.sdist), version),
        *wheel_faults(built.wheel, packaged_files(source)),
    ]
    if faults:
        raise RunFailure(f"the distribution is wrong in {len(faults)} ways; the first: {faults[0]}")


def metadata_faults(metadata: bytes, version: str) -> list[str]:
    """What is wrong with core metadata (METADATA or PKG-INFO), by the rules of the package index."""
    try:
        parsed = Metadata.from_email(metadata, validate=True)
    except ExceptionGroup as group:
        return [str(each) for each in group.exceptions]
    fields = BytesParser().parsebytes(metadata)
    faults = []
    if (parsed.name, str(parsed.version)) != (PACKAGE, version):
        faults.append(f"it is {parsed.name} {parsed.version} instead of {PACKAGE} {version}")
    if (parsed.description_content_type or "").partition(";")[0] != "text/markdown":
        faults.append(
            "Description-Content-Type is not text/markdown: the index would show the README as text"
        )
    if not (parsed.description or "").strip():
        faults.append("the description is empty")
    needed = ("Summary", "License-Expression", "License-File", "Requires-Python", "Requires-Dist")
    faults += [f"{field} is missing" for field in needed if field not in fields]
    faults += [f"unknown classifier '{each}'" for each in parsed.classifiers or [] if each not in classifiers]
    return faults


def wheel_faults(wheel: Path, expected: set[str]) -> list[str]:
    """Files that a wheel lacks, has besides ``expected``, or lists with another digest than they have."""
    faults = []
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        record = next(name for name in names if re.fullmatch(r"[^/]+\.dist-info/RECORD", name))
        rows = list(csv.reader(io.StringIO(archive.read(record).decode())))
        own = {name for name in names if not name.startswith(f"{record.partition('/')[0]}/")}
        faults += [f"{name} is not in the wheel" for name in sorted(expected - own)]
        faults += [f"{name} is in the wheel and not in the source" for name in sorted(own - expected)]
        faults += [f"{name} is not in RECORD" for name in sorted(names - {row[0] for row in rows})]
        for name, digest, _size in rows:
            if name != record and (name not in names or digest != _digest(archive.read(name))):
                faults.append(f"RECORD does not fit {name}")
    return faults


def packaged_files(source: Path) -> set[str]:
    """The files of the package and of its rooms, by their names in the wheel; ``source`` is an export."""
    package = source / PACKAGE
    found = {path for path in package.rglob("*") if path.is_file() and not path.is_symlink()}
    names = {path.relative_to(source).as_posix() for path in found}
    for link in package.rglob("*"):
        if not link.is_symlink():
            continue
        target, name = link.resolve(), link.relative_to(source).as_posix()
        if target.is_file():
            names.add(name)
        files = (path for path in target.rglob("*") if path.is_file())
        names |= {f"{name}/{path.relative_to(target).as_posix()}" for path in files}
    return names


def _digest(content: bytes) -> str:
    """As RECORD states it."""
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()


def _metadata_of_wheel(wheel: Path) -> bytes:
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA")))


def _metadata_of_sdist(sdist: Path) -> bytes:
    with tarfile.open(sdist) as archive:
        stream = archive.extractfile(f"{sdist.name.removesuffix('.tar.gz')}/PKG-INFO")
        return stream.read() if stream is not None else b""


def sha256sums(files: Mapping[str, bytes]) -> str:
    """The text of SHA256SUMS for ``sha256sum --check``: a line for each file, by name."""
    return "".join(f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files))
