"""The recording of a run: recognised wherever it lies, and another one with the same timestamps refused."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.cli.main import main
from polhode.records.dataset import open_sequence
from polhode.run_directory.recording import recording_of, require_recording
from polhode.run_directory.run_folder import record_failure
from polhode.run_directory.summary import build_summary, read_summary, write_summary
from polhode.run_directory.summary_schema import Recording
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import Example, write_example

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def recording(small_sequence: Path) -> Recording:
    return recording_of(open_sequence(small_sequence))


@pytest.fixture
def copied(small_sequence: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(small_sequence, tmp_path / "elsewhere"))


def _left(sequence: Path) -> list[Path]:
    return sorted((sequence / "mav0" / "cam0" / "data").iterdir())


def test_a_corrected_calibration_images_encoded_anew_and_another_decoder_are_the_same(
    recording: Recording, copied: Path
) -> None:
    stamps = open_sequence(copied).timestamps_ns.tolist()
    found = [image.timestamp_ns for image in recording.left_images]
    assert found == [stamps[0], stamps[(len(stamps) - 1) // 2], stamps[-1]]
    images = tuple(image.model_copy(update={"pixels_sha256": 64 * "0"}) for image in recording.left_images)
    require_recording(recording.model_copy(update={"left_images": images}), copied)
    file = copied / "mav0" / "cam0" / "sensor.yaml"
    file.write_text(file.read_text() + "# corrected\n")
    rows = []
    for image in _left(copied):
        Image.open(image).save(image.with_suffix(".tif"))
        image.unlink()
        rows.append(f"{image.stem},{image.stem}.tif")
    (copied / "mav0" / "cam0" / "data.csv").write_text("\n".join(["#timestamp [ns],filename", *rows]) + "\n")
    require_recording(recording, copied)


@pytest.mark.parametrize("number", [0, 2, -1])
def test_an_image_that_was_changed_or_is_not_listed_is_another_recording(
    recording: Recording, copied: Path, number: int
) -> None:
    image = _left(copied)[number]
    pixels = np.asarray(Image.open(image))
    for changed in (pixels ^ 1, pixels[:10, :10]):
        Image.fromarray(changed).save(image)
        with pytest.raises(
            InputError, match=f"not the sequence of this run .*{image.stem} ns is another one"
        ):
            require_recording(recording, copied)
    file = copied / "mav0" / "cam0" / "data.csv"
    kept = [row for row in file.read_text().splitlines() if not row.startswith(image.stem)]
    file.write_text("\n".join(kept) + "\n")
    with pytest.raises(InputError, match=f"it has no left image at {image.stem}"):
        require_recording(recording, copied)


def test_a_sequence_whose_images_were_removed_passes_with_a_warning_and_an_earlier_version_without(
    recording: Recording, copied: Path, caplog: pytest.LogCaptureFixture
) -> None:
    require_recording(None, copied)
    assert caplog.text == ""
    for removed in ("mav0/cam0/data", "mav0/cam0"):
        caplog.clear()
        shutil.rmtree(copied / removed)
        with caplog.at_level(logging.WARNING):
            require_recording(recording, copied)
        assert "no images that show whether it is the sequence of this run" in caplog.text


def test_a_failed_run_records_it(recording: Recording, tmp_path: Path) -> None:
    record_failure(tmp_path, "no motion", recording)
    assert read_summary(tmp_path).data == recording
    write_summary(build_summary(None, None, None, {}), tmp_path / "summary.json")
    record_failure(tmp_path, "no motion", recording)
    assert read_summary(tmp_path).data == recording


@pytest.mark.parametrize(
    "words", [["evaluate", "RUN", "SEQ"], ["compare", "--run", "RUN", "--truth", "SEQ", "-o", "OUT"]]
)
def test_the_truth_of_another_sequence_is_refused(
    words: list[str], recording: Recording, example: Example, at_rest: Path, tmp_path: Path, capsys: Capture
) -> None:
    """``at_rest`` begins at the same instant."""
    run = tmp_path / "run"
    run.mkdir()
    write_example(run, example)
    file = run / "summary.json"
    write_summary(read_summary(file).model_copy(update={"data": recording}), file)
    places = {"RUN": str(run), "SEQ": str(at_rest), "OUT": str(tmp_path / "out")}
    assert main([places.get(word, word) for word in words]) == 2
    line = capsys.readouterr().err
    assert line.startswith("polhode: error: ") and line.count("\n") == 1
    assert f"{at_rest}: not the sequence of this run" in line
    assert not (run / "metrics.json").exists() and not (tmp_path / "out" / "compare.json").exists()
