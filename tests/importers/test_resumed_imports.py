"""Interrupted imports go on where they stopped; only what import itself made is replaced."""

from collections.abc import Iterator
from pathlib import Path

import pytest

import polhode.importers.sources.image_folders as image_folders
from polhode.importers.import_sequence import import_sequence
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import FramedImage, Wanted
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import Silent
from tests.importers.imports import imported, refused, require_same
from tests.importers.recordings import original

Images = image_folders.ImageFiles.images


def stop_after(patch: pytest.MonkeyPatch, count: int, error: BaseException) -> list[FramedImage]:
    """Let the recording stop after so many images; returns those that were read."""
    read: list[FramedImage] = []

    def images(self: image_folders.ImageFiles, wanted: Wanted) -> Iterator[FramedImage]:
        for framed in Images(self, wanted):
            if len(read) == count:
                raise error
            read.append(framed)
            yield framed

    patch.setattr(image_folders.ImageFiles, "images", images)
    return read


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device", "x.png")])
def test_the_same_command_goes_on_and_reads_no_image_twice(
    error: BaseException, small_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "back"
    stop_after(monkeypatch, 5, error)
    expected = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else RunFailure
    with pytest.raises(expected, match="images are kept, the same command goes on from there"):
        imported([small_sequence], out)
    hidden = tmp_path / ".back.partial"
    assert not out.exists()
    there = len(list(hidden.rglob("*.png")))
    assert 0 < there <= 5
    if isinstance(error, OSError):
        # another import starts over
        monkeypatch.undo()
        imported([small_sequence], out, every=2)
        assert len(original(out).files[0]) == 3 and not hidden.exists()
        return
    read = stop_after(monkeypatch, 100, error)
    imported([small_sequence], out)
    assert len(read) == 12 - there and not hidden.exists()
    require_same(original(small_sequence), out)


def test_only_an_unchanged_import_is_replaced(small_sequence: Path, tmp_path: Path) -> None:
    out = tmp_path / "back"
    imported([small_sequence], out)
    assert "exists: choose another folder or pass --overwrite" in refused([small_sequence], out)
    import_sequence([small_sequence], out, ImportOptions(every=2), Silent(), overwrite=True)
    assert len(original(out).files[0]) == 3
    edited = next((out / "mav0" / "cam0" / "data").iterdir())
    edited.write_bytes(b"mine")
    with pytest.raises(
        InputError, match=r"no dataset that polhode import made \(mav0/cam0/data/.* was changed"
    ):
        import_sequence([small_sequence], out, ImportOptions(), Silent(), overwrite=True)
    assert edited.read_bytes() == b"mine"
    # the hidden folder of somebody else stays
    (tmp_path / ".new.partial").mkdir()
    (tmp_path / ".new.partial" / "notes.txt").write_text("mine")
    assert "contains notes.txt, which polhode did not write" in refused([small_sequence], tmp_path / "new")
