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


def items(folder: Path, watched: bool = False, patience_s: float = 0.3) -> list[SourcePair | Passed]:
    return list(FolderSource(folder, watched, patience_s).items(lambda: False))


def stamps(found: list[SourcePair | Passed]) -> list[int]:
    return [each.stamps_ns[0] for each in found if isinstance(each, SourcePair)]


def test_a_recorded_folder_gives_all_its_pairs(small_sequence: Path) -> None:
    found = items(small_sequence)
    assert stamps(found) == ALL
    first = found[0]
    assert isinstance(first, SourcePair) and first.left.shape == (48, 64) and first.X_NB is None
    assert first.names == (f"{ALL[0]}.png", f"{ALL[0]}.png")


def test_a_folder_that_fills_gives_each_pair_when_it_is_complete(small_sequence: Path) -> None:
    whole = small_sequence.with_name("whole")
    shutil.copytree(small_sequence, whole)
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
    found = items(small_sequence, watched=True, patience_s=20.0)
    filling.join()
    assert stamps(found) == ALL[:4] and len(found) == 4
    expected = items(whole)
    for got, want in zip(found, expected, strict=False):
        assert isinstance(got, SourcePair) and isinstance(want, SourcePair)
        np.testing.assert_array_equal(got.right, want.right)


def test_without_a_marker_patience_ends_it(small_sequence: Path) -> None:
    assert stamps(items(small_sequence, watched=True, patience_s=0.2)) == ALL


def test_images_without_a_partner_or_damaged_are_named(small_sequence: Path) -> None:
    mav0 = small_sequence / "mav0"
    write_camera_csv(mav0 / "cam0", [ALL[0], ALL[1], ALL[2], ALL[4]])
    write_camera_csv(mav0 / "cam1", [ALL[0], ALL[2], ALL[3], ALL[4]])
    (mav0 / "cam1" / "data" / f"{ALL[2]}.png").write_bytes(b"no image")
    found = items(small_sequence)
    assert stamps(found) == [ALL[0], ALL[4]]
    told = [each.what for each in found if isinstance(each, Passed)]
    assert told[0] == f"{ALL[1]} ns (only in cam0)"
    assert told[1].startswith(f"{ALL[2]} ns (not an image")
    assert told[2] == f"{ALL[3]} ns (only in cam1)"


def test_stamps_that_differ_a_little_are_a_pair(small_sequence: Path) -> None:
    path = small_sequence / "mav0" / "cam1" / "data.csv"
    rows = [f"{stamp + 1_000_000},{stamp}.png" for stamp in ALL]
    path.write_text("\n".join(rows) + "\n")
    assert [each.stamps_ns for each in items(small_sequence) if isinstance(each, SourcePair)] == [
        (stamp, stamp + 1_000_000) for stamp in ALL
    ]


def test_the_pose_of_the_inspector_belongs_to_the_pair(small_sequence: Path) -> None:
    X_NB = np.tile(np.eye(4), (len(ALL), 1, 1))
    X_NB[:, 0, 3] = 0.1 * np.arange(len(ALL))
    write_inspector(small_sequence / "mav0", TIMESTAMPS_NS, X_NB, 0.01, 0.002)
    source = FolderSource(small_sequence, False, 1.0)
    camera = source.camera_motion()
    assert (camera.sigma_p_m, camera.sigma_theta_rad) == (0.01, 0.002)
    poses = [each.X_NB for each in source.items(lambda: False) if isinstance(each, SourcePair)]
    np.testing.assert_allclose(np.array(poses), X_NB)


def test_wrong_folders_are_refused_in_one_line(small_sequence: Path, tmp_path: Path) -> None:
    wrong = small_sequence / "mav0"
    with pytest.raises(InputError, match="no such sequence"):
        FolderSource(tmp_path / "none", True, 1.0)
    list_file = wrong / "cam0" / "data.csv"
    list_file.write_text("later,a.png\n")
    with pytest.raises(InputError, match="line 1: expected a timestamp"):
        items(wrong.parent)
    list_file.write_text("5,../../secret.png\n")
    with pytest.raises(InputError, match="leads out of the dataset"):
        items(wrong.parent)
    (wrong / "cam1" / "sensor.yaml").unlink()
    with pytest.raises(InputError, match=r"cam1/sensor\.yaml"):
        FolderSource(wrong.parent, True, 1.0)
