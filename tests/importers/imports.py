"""Imports of small recordings, for the tests of this room."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.importers.import_sequence import Imported, import_sequence
from polhode.importers.options import ImportOptions
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.importers.recordings import Original, original


def imported(sources: Sequence[Path], folder: Path, **options: Any) -> Imported:
    """Import with the given options."""
    return import_sequence(sources, folder, ImportOptions(**options), Silent())


def refused(sources: Sequence[Path], folder: Path, **options: Any) -> str:
    """The line of an import that is refused, and leaves nothing behind."""
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(InputError) as caught:
        imported(sources, folder, **options)
    line = str(caught.value)
    assert "\n" not in line and sorted(folder.parent.rglob("*")) == before
    return line


def require_same(data: Original, folder: Path) -> None:
    """Pixels, times and calibration, bit by bit."""
    back = original(folder)
    for camera in (0, 1):
        assert list(back.files[camera]) == list(data.files[0])
        for stamp, own in zip(back.files[camera], data.files[camera], strict=True):
            found, wanted = back.pixels(camera, stamp), data.pixels(camera, own)
            assert found.dtype == wanted.dtype
            np.testing.assert_array_equal(found, wanted)
        name = f"mav0/cam{camera}/sensor.yaml"
        assert (folder / name).read_text() == (data.folder / name).read_text()
