"""The picture of a report is the part of the page that was asked for."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.end_to_end import report_page, report_picture


def test_rows_and_columns_of_the_page_are_cut_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "report.html").write_text("<p>page</p>")

    def picture(_file: Path, width_px: int, section: str | None) -> bytes:
        assert section is None
        rows = np.repeat(np.arange(200, dtype=np.uint8)[:, None], width_px, axis=1)
        stream = io.BytesIO()
        Image.fromarray(rows).save(stream, format="PNG")
        return stream.getvalue()

    monkeypatch.setattr(report_picture, "whole_page", picture)
    report_picture.main(tmp_path, tmp_path / "deep" / "part.png", rows=(20, 60), width=30)
    report_picture.main(tmp_path, tmp_path / "narrow.png", rows=(20, 60), width=30, columns=(10, 28))
    with Image.open(tmp_path / "narrow.png") as image:
        assert image.size == (18, 40)
    with Image.open(tmp_path / "deep" / "part.png") as image:
        found = np.asarray(image.convert("L"))
    assert found.shape == (40, 30) and abs(int(found[0, 0]) - 20) < 4 and abs(int(found[-1, 0]) - 59) < 4


def test_a_run_without_a_report_and_a_machine_without_a_browser_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit, match="no such report"):
        report_picture.main(tmp_path, tmp_path / "part.png")
    (tmp_path / "report.html").touch()
    monkeypatch.setattr(report_page, "browser_path", lambda: None)
    with pytest.raises(SystemExit, match="there is no browser"):
        report_picture.main(tmp_path, tmp_path / "part.png")
