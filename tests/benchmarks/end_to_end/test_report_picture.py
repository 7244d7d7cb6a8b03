"""The picture of a report is the part of the page that was asked for."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.end_to_end import report_picture


def test_rows_of_the_page_are_cut_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "report.html").write_text("<p>page</p>")

    def browser(words: list[str], **_: Any) -> None:
        size = next(word for word in words if word.startswith("--window-size=")).split("=")[1].split(",")
        width, height = map(int, size)
        rows = np.repeat(np.arange(height, dtype=np.uint8)[:, None], width, axis=1)
        Image.fromarray(rows).save(next(w for w in words if w.startswith("--screenshot=")).split("=")[1])

    monkeypatch.setattr(subprocess, "run", browser)
    monkeypatch.setattr(shutil, "which", lambda _: "/bin/browser")
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
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(SystemExit, match="there is no browser"):
        report_picture.main(tmp_path, tmp_path / "part.png")
