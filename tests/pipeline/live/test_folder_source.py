"""Pairs of a folder as they come: complete ones in order, incomplete ones by name."""

import shutil
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from polhode.pipeline.live.folder_source import END_MARKER, FolderSource, Passed, SourcePair
from polhode.records.dataset_writer import write_camera_csv, write_inspector
from polhode.runtime.errors import InputError
from tests.conftest import TIMESTAMPS_NS

ALL = [int(stamp) for stamp in TIMESTAMPS_NS]


def items(folder: Path, watched: bool = False, patience_s: float = 0.3) -> tuple[list[SourcePair], list[str]]:
    """The pairs, and what is passed over."""
    found = list(FolderSource(folder, watched, patience_s).items(lambda: False))
    passed = [each.what for each in found if isinstance(each, Passed)]
    return [each for each in found if isinstance(each, SourcePair)], passed


def stamps(pairs: list[SourcePair]) -> list[int]:
    return [pair.stamps_ns[0] for pair in pairs]


def test_a_recorded_folder_gives_all_its_pairs_with_poses_also_where_stamps_differ_a_little(
    small_sequence: Path,
) -> None:
    for watched in (False, True):
        found, passed = items(small_sequence, watched)
        assert stamps(found) == ALL and not passed
    assert found[0].left.shape == (48, 64) and found[0].X_NB is None
    assert found[0].names == (f"{ALL[0]}.png", f"{ALL[0]}.png")
    path = small_sequence / "mav0" / "cam1" / "data.csv"
    path.write_text("".join(f"{stamp + 1_000_000},{stamp}.png\n" for stamp in ALL))
    X_NB = np.tile(np.eye(4), (len(ALL), 1, 1))
    X_NB[:, 0, 3] = 0.1 * np.arange(len(ALL))
    write_inspector(small_sequence / "mav0", TIMESTAMPS_NS, X_NB, 0.01, 0.002)
    camera = FolderSource(small_sequence, False, 1.0).camera_motion()
    assert (camera.sigma_p_m, camera.sigma_theta_rad) == (0.01, 0.002)
    pairs, _ = items(small_sequence)
    assert [pair.stamps_ns for pair in pairs] == [(t, t + 1_000_000) for t in ALL]
    np.testing.assert_allclose([np.asarray(pair.X_NB) for pair in pairs], X_NB)


def test_a_folder_that_fills_gives_each_pair_when_it_is_complete(small_sequence: Path) -> None:
    whole = Path(shutil.copytree(small_sequence, small_sequence.with_name("whole")))
    for name in ("cam0", "cam1"):
        (small_sequence / "mav0" / name / "data.csv").unlink()
        shutil.rmtree(small_sequence / "mav0" / name / "data")

    def fill() -> None:
        for count, stamp in enumerate(ALL[:4], 1):
            # cam1 and its list come later than cam0's, and the line comes before the image is complete
            for name in ("cam0", "cam1"):
                camera, data = small_sequence / "mav0" / name, whole / "mav0" / name / "data"
                (camera / "data").mkdir(exist_ok=True)
                content = (data / f"{stamp}.png").read_bytes()
                (camera / "data" / f"{stamp}.png").write_bytes(content[:100])
                write_camera_csv(camera, ALL[:count])
                time.sleep(0.06)
                (camera / "data" / f"{stamp}.png").write_bytes(content)
        (small_sequence / "mav0" / END_MARKER).touch()

    filling = threading.Thread(target=fill)
    filling.start()
    found, passed = items(small_sequence, watched=True, patience_s=20.0)
    filling.join()
    assert stamps(found) == ALL[:4] and not passed
    for got, want in zip(found, items(whole)[0], strict=False):
        np.testing.assert_array_equal(got.right, want.right)


def test_images_without_a_partner_or_damaged_are_named(small_sequence: Path) -> None:
    mav0 = small_sequence / "mav0"
    write_camera_csv(mav0 / "cam0", [ALL[0], ALL[1], ALL[2], ALL[4]])
    write_camera_csv(mav0 / "cam1", [ALL[0], ALL[2], ALL[3], ALL[4]])
    (mav0 / "cam1" / "data" / f"{ALL[2]}.png").write_bytes(b"no image")
    found, passed = items(small_sequence)
    assert stamps(found) == [ALL[0], ALL[4]]
    assert [passed[0], passed[2]] == [f"{ALL[1]} ns (only in cam0)", f"{ALL[3]} ns (only in cam1)"]
    assert passed[1].startswith(f"{ALL[2]} ns (not an image")


def test_wrong_folders_are_refused_in_one_line(small_sequence: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such sequence"):
        FolderSource(tmp_path / "none", True, 1.0)
    for line, words in (
        ("later,a.png\n", "line 1: expected a timestamp"),
        ("5,../../secret.png\n", "leads out of the dataset"),
    ):
        (small_sequence / "mav0" / "cam0" / "data.csv").write_text(line)
        with pytest.raises(InputError, match=words):
            items(small_sequence)
    (small_sequence / "mav0" / "cam1" / "sensor.yaml").unlink()
    with pytest.raises(InputError, match=r"cam1/sensor\.yaml"):
        FolderSource(small_sequence, True, 1.0)
