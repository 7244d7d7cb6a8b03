"""The dataset on its way: a hidden folder beside its place, resumed by the same command, published when
whole.

``import.json`` beside mav0/ lists every file with its size; a folder is ours when it holds these and nothing
else.
"""

import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polhode.files.atomic import write_text
from polhode.files.json_files import read_json
from polhode.files.output.exchange import foreign, is_regular
from polhode.files.output.resumable_dataset import DatasetMaker
from polhode.records.range_images import RANGE_FOLDER
from polhode.runtime.errors import InputError

RECORD = "import.json"
SCHEMA = "polhode-import/1"
FINGERPRINT = ".imported_from"

_DATASET = re.compile(
    r"mav0/((?:cam[01]|range0)/(sensor\.yaml|data\.csv|data/-?\d+\.\w{2,5})|masks[01]/-?\d+\.png"
    r"|inspector0/(sensor\.yaml|data\.csv)|wrench0/data\.csv|calibration_covariance\.npz)"
)
_PARTIAL = re.compile(r"(?P<folder>(?:.*/)?)\.(?P<stem>[^/]+)\.partial-\d+(?P<suffix>\.\w+)?")


@dataclass(frozen=True)
class ImportedDataset:
    """The hidden folder."""

    path: Path
    has_ranges: bool = False
    """Whether range images take the place of the second camera"""

    @property
    def mav0(self) -> Path:
        """Folder of the dataset's files."""
        return self.path / "mav0"

    def folder(self, camera: int) -> Path:
        """Of camera 0 (left) or 1 (right), or of the range images in the place of the latter."""
        return self.mav0 / (RANGE_FOLDER if camera == 1 and self.has_ranges else f"cam{camera}")

    def images_there(self, camera: int) -> dict[str, str]:
        """Complete images of a camera: timestamp -> file name."""
        folder = self.folder(camera) / "data"
        if not folder.is_dir():
            return {}
        names = (each.name for each in folder.iterdir())
        return {name.partition(".")[0]: name for name in names if not name.startswith(".")}

    def write_record(self, content: dict[str, Any]) -> None:
        """List all files, with ``content``, in ``import.json``."""
        files = {
            each.relative_to(self.path).as_posix(): each.stat().st_size
            for each in sorted(self.mav0.rglob("*"))
            if each.is_file()
        }
        record = {"schema": SCHEMA, **content, "files": files}
        write_text(self.path / RECORD, json.dumps(record, indent=1) + "\n")


def is_own_file(name: str) -> bool:
    """Whether ``import`` writes a file of this name, relative to the dataset, with "/"."""
    partial = _PARTIAL.fullmatch(name)
    if partial is not None:
        name = partial["folder"] + partial["stem"] + (partial["suffix"] or "")
    return name in (RECORD, FINGERPRINT) or _DATASET.fullmatch(name) is not None


def why_not_ours(folder: Path) -> str:
    """What speaks against a folder being a dataset of ``import`` and nothing else; empty: nothing does."""
    record = folder / RECORD
    if not (record.is_file() and is_regular(record)):
        return f"it has no {RECORD}"
    try:
        content = read_json(record, "a record of an import", 2**29)
        listed = {str(name): int(size) for name, size in content["files"].items()}
        if content["schema"] != SCHEMA:
            return f"its {RECORD} is of another version"
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        return f"its {RECORD} cannot be read"
    others = foreign(folder, lambda name: name == RECORD or (name in listed and is_own_file(name)))
    if others:
        return f"it holds {others[0]}"
    changed = [name for name, size in listed.items() if not _has_size(folder / name, size)]
    return f"{changed[0]} was changed or removed" if changed else ""


def _has_size(path: Path, size: int) -> bool:
    try:
        return path.stat().st_size == size
    except OSError:
        return False


IMPORTED = DatasetMaker("import", is_own_file, why_not_ours, FINGERPRINT)
require_free = IMPORTED.require_free


@contextmanager
def staged_import(
    folder: Path, overwrite: bool, fingerprint: str, has_ranges: bool = False
) -> Iterator[ImportedDataset]:
    """A new or resumed hidden folder that takes the place of ``folder`` if the block succeeds.

    ``fingerprint`` identifies sources and options.
    """

    def kept(path: Path) -> str:
        dataset = ImportedDataset(path, has_ranges)
        there = sum(len(dataset.images_there(camera)) for camera in (0, 1))
        return f"{there} images" if there else ""

    with IMPORTED.staged(folder, overwrite, fingerprint, kept) as path:
        for partial in path.rglob(".*.partial-*"):
            if partial.is_dir():
                shutil.rmtree(partial, ignore_errors=True)
            else:
                partial.unlink(missing_ok=True)
        yield ImportedDataset(path, has_ranges)
