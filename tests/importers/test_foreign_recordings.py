"""Bags, videos, images and masks as the field has them: read right, said, or refused in one line."""

import io
import json
import shutil
import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from polhode.cli.main import main
from polhode.importers.sources.ros_bag import recorded_parts
from polhode.pipeline.checkout.checkout import checkout
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import write_camera_csv, write_png, write_sensor
from polhode.runtime.errors import InputError
from tests.conftest import TIMESTAMPS_NS
from tests.importers import recordings
from tests.importers.foreign_calibrations import PROGRAMS
from tests.importers.foreign_recordings import BagImage, encode, trimmed, write_bag, write_mcap_of
from tests.importers.imports import imported, refused, require_same
from tests.importers.recordings import Original, original, write_folders, write_kalibr

HALF_NS = 500_000_000
TOPICS = ("/left/image", "/right/image")


@pytest.fixture
def data(small_sequence: Path) -> Original:
    return original(small_sequence)


def chain(data: Original, area: Path) -> dict[str, Any]:
    return {"calibration": (write_kalibr(data, area / "k.yaml"),)}


def messages(data: Original, clock: Callable[[int], int], encoding: str = "mono8") -> list[BagImage]:
    """Both cameras' images in the order of recording, at the times that a clock had."""
    rows = []
    for k, stamp in enumerate(data.files[0]):
        for camera, topic in enumerate(TOPICS):
            rows.append(BagImage(topic, clock(k), clock(k), data.pixels(camera, stamp), encoding))
    return rows


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap", "mcap-ros1"])
def test_a_clock_that_was_set_back_makes_parts_of_which_the_longest_is_imported(
    kind: str, data: Original, tmp_path: Path
) -> None:
    # the clock goes back by 1.25 s after two pairs: the second part interleaves with the first
    stamps = [10**9 + k * HALF_NS - (k >= 2) * 1_250_000_000 for k in range(6)]
    name = {"ros1": "a.bag", "sqlite3": "bag"}.get(kind, "a.mcap")
    bag = write_bag(tmp_path / name, messages(data, lambda k: stamps[k]), kind)
    done = imported([bag], tmp_path / "back", **chain(data, tmp_path))
    assert "the clock was set back while it was recorded, which makes 2 parts; part 2" in done.warnings[0]
    assert "4 images of the others are left out" in done.warnings[0]
    back = original(tmp_path / "back")
    assert list(back.files[0]) == stamps[2:]
    for stamp, own in zip(stamps[2:], list(data.files[0])[2:], strict=True):
        np.testing.assert_array_equal(back.pixels(1, stamp), data.pixels(1, own))


def test_where_one_cameras_clock_alone_is_set_back_the_first_part_is_imported(
    data: Original, tmp_path: Path
) -> None:
    right = [10**9 + k * HALF_NS for k in range(12)]
    left = [stamp - (k >= 4) * 2_250_000_000 for k, stamp in enumerate(right)]
    twice = [stamp for _ in range(2) for stamp in data.files[0]]
    rows = [
        BagImage(topic, clock[k], clock[k], data.pixels(camera, stamp), "mono8")
        for k, stamp in enumerate(twice)
        for camera, (topic, clock) in enumerate(zip(TOPICS, (left, right), strict=True))
    ]
    bag = write_bag(tmp_path / "bag", rows, "sqlite3")
    done = imported([bag], tmp_path / "first", **chain(data, tmp_path))
    assert "makes 2 parts; part 1 is imported" in done.warnings[0]
    assert list(original(tmp_path / "first").files[0]) == right[:4]


def test_parts_of_a_recording() -> None:
    late = [k * 10**9 for k in (0, 1, 2, 4, 3, 5, 6, 7, 8)]
    assert recorded_parts(late, None).tolist() == 9 * [0]
    # by three intervals, and by one and a half
    for step in (0.307, 0.15):
        stamps = [round((0.1 * k - step * (k >= 10)) * 1e9) for k in range(20)]
        assert recorded_parts(stamps, None).tolist() == 10 * [0] + 10 * [1]
    assert recorded_parts([5 * 10**9, 6 * 10**9, 0, 10**9], None).tolist() == [0, 0, 1, 1]
    # read by time, recorded in another order
    logged = np.array([5, 6, 0, 1, 2]) * 10**9
    assert recorded_parts(np.sort(logged), logged).tolist() == [1, 1, 1, 0, 0]


def png(pixels: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


def test_compressed_topics_by_any_name_and_files_by_any_case(data: Original, tmp_path: Path) -> None:
    rows = [
        BagImage(each.topic, each.logged_ns, each.stamp_ns, png(np.asarray(each.content)), "png")
        for each in messages(data, lambda k: int(TIMESTAMPS_NS[k]))
    ]
    bag = write_bag(tmp_path / "a.bag", rows, "ros1").rename(tmp_path / "UPPER.BAG")
    imported([bag], tmp_path / "back", **chain(data, tmp_path), left_topic=TOPICS[0], right_topic=TOPICS[1])
    require_same(data, tmp_path / "back")
    imported([bag], tmp_path / "found", **chain(data, tmp_path))
    require_same(data, tmp_path / "found")


DRIVERS = {
    "RealSense": ("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"),
    "ZED": ("/zed/zed_node/left/image_rect_gray", "/zed/zed_node/right/image_rect_gray"),
    "OAK": ("/oak/left/image_rect", "/oak/right/image_rect"),
    "DepthAI, beside colour": (
        "/depthai/left/image_raw",
        "/depthai/right/image_raw",
        "/depthai/rgb/image_raw",
    ),
    "Isaac Sim": ("/front_stereo_camera/left/image_raw", "/front_stereo_camera/right/image_raw"),
    "Blackfly": ("/cam_0/image_raw", "/cam_1/image_raw"),
    "Gazebo": ("/stereo/camera/left/image_raw/compressed", "/stereo/camera/right/image_raw/compressed"),
}


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_cameras_of_drivers_are_told_apart(driver: str, data: Original, tmp_path: Path) -> None:
    rows = []
    for stamp in data.files[0]:
        for k, topic in enumerate(DRIVERS[driver]):
            pixels = data.pixels(min(k, 1), stamp)
            content, kind = (png(pixels), "png") if "compressed" in topic else (pixels, "mono8")
            rows.append(BagImage(topic, stamp, stamp, content, kind))
    imported([write_bag(tmp_path / "bag", rows)], tmp_path / "back", **chain(data, tmp_path))
    require_same(data, tmp_path / "back")


def both_with_the_same_tx(data: Original) -> Any:
    R, P = recordings.rectified(data)
    P[0][0, 3] = P[1][0, 3]
    return R, P


def nothing_but_K(data: Original) -> Any:
    return (np.zeros((3, 3)),) * 2, (np.zeros((3, 4)),) * 2


def without_sign(data: Original) -> Any:
    R, P = recordings.rectified(data)
    P[1][0, 3] *= -1.0
    return R, P


@pytest.mark.parametrize("stated", [both_with_the_same_tx, nothing_but_K, without_sign])
def test_what_drivers_state_is_completed_by_the_frames_of_tf(
    stated: Callable[[Original], Any], data: Original, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = stated(data)
    monkeypatch.setattr(recordings, "rectified", lambda _: wrong)
    with_tf = recordings.write_ros1(data, tmp_path / "tf.bag")
    done = imported([with_tf], tmp_path / "back")
    assert done.understood["baseline"] == "0.09 m" and done.warnings == ()
    np.testing.assert_allclose(original(tmp_path / "back").X_01, data.X_01, atol=1e-12)
    bare = recordings.write_ros1(data, tmp_path / "bare.bag", recordings.BagContents(tf=False))
    if stated is without_sign:
        assert "Tx is positive in P" in imported([bare], tmp_path / "signed").warnings[0]
    else:
        line = refused([bare], tmp_path / "o" / "s")
        assert "no tf_static links them; give --calibration" in line


COLOURS: dict[str, Callable[[NDArray[np.uint8]], NDArray[Any]]] = {
    "bgr8": lambda grey: np.repeat(grey[..., None], 3, axis=2),
    "rgba8": lambda grey: np.dstack([grey, grey, grey, np.full_like(grey, 9)]),
    "mono16": lambda grey: grey.astype(np.uint16) << 8,
    "mono12": lambda grey: grey.astype(np.uint16) << 4,
    "rgb16": lambda grey: np.repeat(grey[..., None].astype(np.uint16) << 8, 3, axis=2),
    "bgra16": lambda grey: np.dstack([grey, grey, grey, grey]).astype(np.uint16) << 8,
    "bayer_rggb12": lambda grey: np.full_like(grey, 77).astype(np.uint16) << 4,
    "bayer_grbg16": lambda grey: np.full_like(grey, 77).astype(np.uint16) << 8,
}


@pytest.mark.parametrize("encoding", COLOURS)
def test_encodings_of_cameras(encoding: str, data: Original, tmp_path: Path) -> None:
    rows = [
        BagImage(
            each.topic, each.logged_ns, each.stamp_ns, COLOURS[encoding](np.asarray(each.content)), encoding
        )
        for each in messages(data, lambda k: int(TIMESTAMPS_NS[k]))
    ]
    imported([write_bag(tmp_path / "bag", rows)], tmp_path / "back", **chain(data, tmp_path))
    first = int(TIMESTAMPS_NS[0])
    grey = original(tmp_path / "back").pixels(0, first)
    wanted = (
        data.pixels(0, first).astype(np.float64) if "bayer" not in encoding else np.full(grey.shape, 77.0)
    )
    shift = 4 if encoding.endswith("12") else 8 if grey.dtype == np.uint16 else 0
    np.testing.assert_allclose(grey, wanted * 2.0**shift, atol=1.0)


def test_a_packed_pattern_is_refused(data: Original, tmp_path: Path) -> None:
    rows = messages(data, lambda k: int(TIMESTAMPS_NS[k]), "bayer_rggb12")
    line = refused([write_bag(tmp_path / "bag", rows)], tmp_path / "out" / "back", **chain(data, tmp_path))
    assert "3072 bytes do not hold 64x48 px of bayer_rggb12" in line


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1", "compressedDepth"])
def test_a_depth_topic_beside_an_image_becomes_ranges(encoding: str, data: Original, tmp_path: Path) -> None:
    depth_m = np.linspace(0.4, 0.9, 48 * 64).reshape(48, 64)
    millimetres = np.rint(1e3 * depth_m).astype(np.uint16)
    rows = []
    for k, stamp in enumerate(data.files[0]):
        at, content = int(TIMESTAMPS_NS[k]), millimetres + np.uint16(k)
        if encoding == "32FC1":
            content = np.where(np.arange(64) < 2, np.nan, depth_m + 1e-3 * k).astype(np.float32)
        packed = struct.pack("<iff", 0, 0.0, 0.0) + png(content) if encoding == "compressedDepth" else content
        name = "16UC1; compressedDepth png" if encoding == "compressedDepth" else encoding
        rows.append(BagImage("/camera/color/image_raw", at, at, data.pixels(0, stamp), "mono8"))
        rows.append(BagImage("/camera/aligned_depth_to_color/image_raw", at, at, packed, name))
    bag, rig = write_bag(tmp_path / "bag", rows), chain(data, tmp_path)
    assert "give --range-sigma-m, the standard deviation" in refused([bag], tmp_path / "out" / "s", **rig)
    done = imported([bag], tmp_path / "back", **rig, range_sigma_m=0.002)
    assert done.kind == "images with ranges" and "0.001 m per unit" in done.notes[0]
    sequence = open_sequence(tmp_path / "back")
    found = sequence.read_range(0)
    assert np.isnan(found[:, :2]).all() == (encoding == "32FC1")
    # along the ray, of a depth along the axis
    assert np.nanmin(found[:, 2:]) == pytest.approx(0.4, abs=0.1)
    named = {"left_topic": rows[0].topic, "right_topic": rows[1].topic, "range_sigma_m": 0.002}
    imported([bag], tmp_path / "named", **rig, **named)


def test_an_mcap_without_ros_and_packed_files_are_named(tmp_path: Path) -> None:
    json_bag = write_mcap_of(tmp_path / "json.mcap", "json")
    assert "an MCAP of json messages; only those of ROS (cdr, ros1)" in refused(
        [json_bag], tmp_path / "o" / "s"
    )
    empty = write_mcap_of(tmp_path / "empty.mcap", None)
    assert "an empty bag, without a single message" in refused([empty], tmp_path / "o" / "s")
    for name in ("a.db3.zstd", "a.bag.gz", "images.zip"):
        (tmp_path / name).write_bytes(b"packed")
        line = refused([tmp_path / name], tmp_path / "o" / "s")
        assert line == f"{tmp_path / name}: a compressed file; unpack it first, and give what is in it"


def levels(count: int, shift: int = 0) -> list[NDArray[np.uint8]]:
    """Frames that differ in brightness, by 4 levels each."""
    frame = np.full((48, 64), 20, np.uint8)
    frame[8:40, 8:56] = 60
    return [frame + np.uint8(4 * (k + shift)) for k in range(count)]


def brightness(folder: Path, camera: int = 0) -> list[int]:
    """The numbers of the frames that were imported."""
    data = original(folder)
    return [
        round((float(np.median(data.pixels(camera, stamp)[10:38, 10:54])) - 60) / 4)
        for stamp in data.files[camera]
    ]


def test_a_trimmed_video_begins_where_it_was_cut(data: Original, tmp_path: Path) -> None:
    rig = chain(data, tmp_path)
    left = encode(levels(24), tmp_path / "left.mp4", rate_hz=10)
    # key frames elsewhere: other packets are hidden
    right = encode(levels(24), tmp_path / "right.mp4", rate_hz=10, group=4)
    cut = [trimmed(path, tmp_path / f"cut_{path.name}", Fraction(7, 10)) for path in (left, right)]
    imported(cut, tmp_path / "back", **rig)
    assert brightness(tmp_path / "back") == brightness(tmp_path / "back", 1) == list(range(7, 24))
    stamps = list(original(tmp_path / "back").files[0])
    assert stamps[0] == 0 and np.diff(stamps).tolist() == 16 * [100_000_000]


def test_a_turned_video_is_turned_back(data: Original, tmp_path: Path) -> None:
    """By the matrix of its track: a quarter turn, as phones write it."""
    frame = np.zeros((64, 48), np.uint8)
    frame[4:20, 6:40] = 200
    both = [encode([frame + np.uint8(k) for k in range(6)], tmp_path / f"{side}.mp4") for side in "lr"]
    for path in both:
        content = bytearray(path.read_bytes())
        at = content.index(b"tkhd") + 44
        content[at : at + 36] = struct.pack(">9i", 0, 65536, 0, -65536, 0, 0, 0, 0, 1 << 30)
        path.write_bytes(content)
    done = imported(both, tmp_path / "back", **chain(data, tmp_path))
    assert "turned by 270 degrees, as its tag says" in done.notes[0]
    found = original(tmp_path / "back").pixels(0, 0)
    assert np.abs(found.astype(int) - np.rot90(frame, -1)).mean() < 2.0


def test_a_raw_stream_needs_times(data: Original, tmp_path: Path) -> None:
    rig = chain(data, tmp_path)
    both = [encode(levels(8), tmp_path / f"{side}.h264") for side in ("left", "right")]
    line = refused(both, tmp_path / "o" / "s", **rig)
    assert "a raw stream of H.264, whose frames have no times; give --rate-hz, or --stamps FILE" in line
    imported(both, tmp_path / "back", **rig, rate_hz=4.0)
    assert brightness(tmp_path / "back") == list(range(8))
    (tmp_path / "t.txt").write_text("# timecode format v2\n" + "".join(f"{250 * k}\n" for k in range(8)))
    imported(both, tmp_path / "stamped", **rig, stamps=(tmp_path / "t.txt",))
    for name in ("back", "stamped"):
        assert list(original(tmp_path / name).files[0]) == [k * 250_000_000 for k in range(8)]


def oriented(pixels: NDArray[Any], orientation: int) -> bytes:
    """The image turned, with the tag that turns it back."""
    back = {
        1: pixels, 2: pixels[:, ::-1], 3: pixels[::-1, ::-1], 4: pixels[::-1], 5: pixels.T,
        6: np.rot90(pixels, 1), 7: pixels[::-1, ::-1].T, 8: np.rot90(pixels, -1),
    }[orientation]  # fmt: skip
    exif, stream = Image.Exif(), io.BytesIO()
    exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(back)).save(stream, format="PNG", exif=exif)
    return stream.getvalue()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_are_turned_as_their_files_say(orientation: int, data: Original, tmp_path: Path) -> None:
    folders = write_folders(data, tmp_path / "images")
    for folder in folders:
        for path in folder.iterdir():
            path.write_bytes(oriented(np.asarray(Image.open(path)), orientation))
    done = imported(folders, tmp_path / "back", **chain(data, tmp_path))
    assert done.notes == (
        ("12 images were turned as their EXIF orientation says",) if orientation > 1 else ()
    )
    for stamp in data.files[0]:
        np.testing.assert_array_equal(original(tmp_path / "back").pixels(0, stamp), data.pixels(0, stamp))


def floating(path: Path, grey: NDArray[np.uint8]) -> None:
    Image.fromarray(grey.astype(np.float32)).save(path.with_suffix(".tif"))


def four_inks(path: Path, grey: NDArray[np.uint8]) -> None:
    Image.fromarray(grey).convert("CMYK").save(path.with_suffix(".jpg"))


def plain_text(path: Path, grey: NDArray[np.uint8]) -> None:
    rows = "\n".join(" ".join(map(str, row)) for row in grey.tolist())
    path.with_suffix(".pgm").write_text(f"P2\n{grey.shape[1]} {grey.shape[0]}\n255\n{rows}\n")


def deep_colours(path: Path, grey: NDArray[np.uint8]) -> None:
    import cv2

    cv2.imwrite(str(path), np.repeat(grey[..., None].astype(np.uint16) << 8, 3, axis=2))


KINDS: dict[str, Callable[[Path, NDArray[np.uint8]], None]] = {
    "floating-point values": floating,
    "colours of the kind CMYK": four_inks,
    "pixels as plain text": plain_text,
    "colours of 16 bits": deep_colours,
}


@pytest.mark.parametrize("words", KINDS)
def test_kinds_of_images_that_no_run_reads_are_refused_at_import(
    words: str, data: Original, tmp_path: Path
) -> None:
    folders = write_folders(data, tmp_path / "images")
    for folder in folders:
        for path in list(folder.iterdir()):
            grey = np.asarray(Image.open(path))
            path.unlink()
            KINDS[words](path, grey)
    line = refused(folders, tmp_path / "o" / "s", **chain(data, tmp_path))
    assert words in line and "save it" in line and "0 of 6 pairs are left" in line


def write_masks(
    mav0: Path, names: Sequence[str], value: int = 255, folder: str = "masks0"
) -> NDArray[np.bool_]:
    mask = np.zeros((48, 64), np.uint8)
    mask[10:40, 10:50] = value
    for name in names:
        path = mav0 / folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask).convert("L").save(path)
    return mask > 0


@pytest.mark.parametrize("name", ["{ns}.png", "{ns}.jpg", "{ns}.png.png", "data/{ns}.png", "{stem}.png"])
def test_masks_by_the_names_that_people_give_them(name: str, small_sequence: Path, tmp_path: Path) -> None:
    mav0 = small_sequence / "mav0"
    if "stem" in name:
        for camera in (0, 1):
            names = [f"frame{k:04d}.png" for k in range(len(TIMESTAMPS_NS))]
            for stamp, new in zip(TIMESTAMPS_NS, names, strict=True):
                (mav0 / f"cam{camera}/data/{stamp}.png").rename(mav0 / f"cam{camera}/data/{new}")
            rows = [f"{stamp},{new}" for stamp, new in zip(TIMESTAMPS_NS, names, strict=True)]
            (mav0 / f"cam{camera}/data.csv").write_text("#timestamp [ns],filename\n" + "\n".join(rows) + "\n")
    stems = [f"frame{k:04d}" for k in range(len(TIMESTAMPS_NS))]
    given = [name.format(ns=ns, stem=stem) for ns, stem in zip(TIMESTAMPS_NS, stems, strict=True)]
    mask = write_masks(mav0, given)
    sequence = open_sequence(small_sequence)
    found = sequence.read_pair(3).mask_left
    assert found is not None and np.mean(found == mask) > 0.99
    imported([small_sequence], tmp_path / "back")
    copied = open_sequence(tmp_path / "back").read_pair(3).mask_left
    np.testing.assert_array_equal(copied, found)


def test_masks_that_belong_to_nothing_or_mean_something_else_are_said(
    small_sequence: Path, tmp_path: Path
) -> None:
    mav0, names = small_sequence / "mav0", [f"{ns}.png" for ns in TIMESTAMPS_NS]
    write_masks(mav0, [f"{k:04d}.png" for k in range(6)])
    with pytest.raises(
        InputError, match=r"none of its 6 masks belongs to an image: masks are called 0000\.png"
    ):
        open_sequence(small_sequence)
    assert "masks are called 0000.png, images" in refused([small_sequence], tmp_path / "o" / "s")
    shutil.rmtree(mav0 / "masks0")
    write_masks(mav0, [*names, "other.png"])
    assert any(
        "1 masks belong to no image (first: other.png)" in w for w in open_sequence(small_sequence).warnings
    )
    (mav0 / "masks0" / "other.png").unlink()
    for name in names:
        mask = np.zeros((48, 64), np.uint8)
        mask[10:40, 10:50], mask[20:24] = 255, 128
        write_png(mav0 / "masks0" / name, mask)
    warnings = open_sequence(small_sequence).warnings
    assert any("have the values 0, 128, 255: all but 0 count as target" in line for line in warnings)
    for name in names:
        mask = np.full((48, 64), 255, np.uint8)
        mask[10:40, 10:50] = 0
        write_png(mav0 / "masks0" / name, mask)
    assert any("they look inverted" in line for line in open_sequence(small_sequence).warnings)
    assert any(
        "they look inverted" in line for line in imported([small_sequence], tmp_path / "back").warnings
    )


def test_masks_that_say_nothing_or_are_elsewhere_are_said(small_sequence: Path, tmp_path: Path) -> None:
    mav0, names = small_sequence / "mav0", [f"{ns}.png" for ns in TIMESTAMPS_NS]
    (mav0 / "masks0").mkdir()
    (mav0 / "masks0" / f"{TIMESTAMPS_NS[0]}.npy").write_bytes(b"mask")
    assert "no masks in it (.png" in refused([small_sequence], tmp_path / "o" / "s")
    shutil.rmtree(mav0 / "masks0")
    for values, words in (
        ((1, 2), "cover whole images"),
        ((0, 0), "are empty"),
        ((1, 255), "cover whole images"),
    ):
        for name in names:
            mask = np.full((48, 64), values[0], np.uint8)
            mask[10:40, 10:50] = values[1]
            (mav0 / "masks0").mkdir(exist_ok=True)
            Image.fromarray(mask).save(mav0 / "masks0" / name)
        assert any(words in line for line in open_sequence(small_sequence).warnings)
    # a cut-out: the mask is its transparency
    cut = np.full((48, 64, 4), 200, np.uint8)
    cut[..., 3] = 0
    cut[10:40, 10:50, 3] = 255
    for name in names:
        Image.fromarray(cut).save(mav0 / "masks0" / name)
    np.testing.assert_array_equal(open_sequence(small_sequence).read_pair(1).mask_left, cut[..., 3] > 0)
    done = imported([small_sequence], tmp_path / "back")
    assert done.understood["masks"] == "6 left"
    (mav0 / "masks0").rename(mav0 / "cam0" / "masks")
    assert "mav0/cam0/masks is not used" in open_sequence(small_sequence).warnings[0]
    assert "cam0/masks is not used" in imported([small_sequence], tmp_path / "elsewhere").warnings[0]


@pytest.mark.parametrize("layout", ["raw", "odometry"])
def test_a_folder_of_kitti(layout: str, data: Original, tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    for camera in (0, 1):
        folder = drive / (f"image_{camera:02d}/data" if layout == "raw" else f"image_{camera}")
        folder.mkdir(parents=True)
        for k, path in enumerate(data.files[camera].values()):
            shutil.copy(path, folder / (f"{k:010d}.png" if layout == "raw" else f"{k:06d}.png"))
        if layout == "raw":
            rows = [f"2011-09-26 13:02:{25 + k // 2}.{(k % 2) * HALF_NS:09d}" for k in range(6)]
            (folder.parent / "timestamps.txt").write_text("\n".join(rows) + "\n")
    if layout == "odometry":
        (drive / "times.txt").write_text("".join(f"{k * 0.5:.6e}\n" for k in range(6)))
    P = "50.0 0.0 31.5 {} 0.0 50.0 23.5 0.0 0.0 0.0 1.0 0.0"
    name, key = ("calib_cam_to_cam.txt", "P_rect_{:02d}") if layout == "raw" else ("calib.txt", "P{}")
    rows = [f"{key.format(k)}: {P.format(-4.5 * k)}" for k in (0, 1)] + ["S_00: 1392.0 512.0"]
    (drive / name).write_text("\n".join(rows) + "\n")
    imported([drive], tmp_path / "back")
    back = original(tmp_path / "back")
    stamps = list(back.files[0])
    assert np.diff(stamps).tolist() == 5 * [HALF_NS] and back.X_01[0, 3] == pytest.approx(0.09)
    for k, own in enumerate(data.files[1]):
        np.testing.assert_array_equal(back.pixels(1, stamps[k]), data.pixels(1, own))


def test_numbered_images_beside_their_camera_and_times_without_a_table(
    data: Original, tmp_path: Path
) -> None:
    rig = chain(data, tmp_path)
    for camera in (0, 1):
        folder = tmp_path / f"side{camera}"
        folder.mkdir()
        for k, path in enumerate(data.files[camera].values()):
            shutil.copy(path, folder / f"{k:04d}_cam{camera}.png")
    both = [tmp_path / "side0", tmp_path / "side1"]
    assert "the name 0000_cam0.png states no time; give --rate-hz" in refused(
        both, tmp_path / "o" / "s", **rig
    )
    imported(both, tmp_path / "back", **rig, rate_hz=2.0)
    assert list(original(tmp_path / "back").files[0]) == [k * HALF_NS for k in range(6)]


def test_a_table_that_names_the_images_is_not_taken_in_their_order(data: Original, tmp_path: Path) -> None:
    """A counter that wrapped while it recorded."""
    folders = []
    names = [f"img_{(997 + k) % 1000:03d}.png" for k in range(6)]
    for camera in (0, 1):
        folders.append(tmp_path / f"side{camera}")
        folders[-1].mkdir()
        for name, path in zip(names, data.files[camera].values(), strict=True):
            shutil.copy(path, folders[-1] / name)
    table = tmp_path / "times.csv"
    table.write_text("timestamp,filename\n" + "".join(f"{0.5 * k},{name}\n" for k, name in enumerate(names)))
    imported(folders, tmp_path / "back", **chain(data, tmp_path), stamps=(table,))
    back = original(tmp_path / "back")
    for k, own in enumerate(data.files[1]):
        np.testing.assert_array_equal(back.pixels(1, k * HALF_NS), data.pixels(1, own))
    table.write_text(table.read_text().replace("img_998", "img_500"))
    line = refused(folders, tmp_path / "o" / "s", **chain(data, tmp_path), stamps=(table,))
    assert "but not img_998.png; give the table of these images" in line


def test_times_of_an_euroc_folder_have_the_unit_of_their_header(data: Original, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    shutil.copytree(data.folder, folder)
    for camera in (0, 1):
        path = folder / f"mav0/cam{camera}/data.csv"
        rows = [f"{ns // 1000},{ns}.png" for ns in TIMESTAMPS_NS]
        path.write_text("#timestamp [us],filename\n" + "\n".join(rows) + "\n")
    imported([folder], tmp_path / "back")
    require_same(data, tmp_path / "back")
    for camera in (0, 1):
        path = folder / f"mav0/cam{camera}/data.csv"
        path.write_text(path.read_text().replace(" [us]", ""))
    assert "state the unit of data.csv: --time-unit" in refused([folder], tmp_path / "o" / "s")
    imported([folder], tmp_path / "stated", time_unit="us")
    require_same(data, tmp_path / "stated")
    for wrong in ({"rate_hz": 20.0}, {"stamps": (folder,)}):
        assert "leave --stamps and --rate-hz out" in refused([folder], tmp_path / "o" / "s", **wrong)


def test_frames_of_an_avi_are_in_the_order_in_which_they_are_shown(data: Original, tmp_path: Path) -> None:
    both = [encode(levels(12), tmp_path / f"{side}.avi", rate_hz=10) for side in ("left", "right")]
    imported(both, tmp_path / "back", **chain(data, tmp_path), rate_hz=10.0)
    assert brightness(tmp_path / "back") == list(range(12))


def test_euroc_without_sensor_yaml_and_with_opencvs_version_of_yaml(data: Original, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    shutil.copytree(data.folder, folder)
    for camera in (0, 1):
        path = folder / f"mav0/cam{camera}/sensor.yaml"
        path.write_text(f"%YAML:1.0\n---\n{path.read_text()}")
    imported([folder], tmp_path / "versioned")
    require_same(data, tmp_path / "versioned")
    for camera in (0, 1):
        (folder / f"mav0/cam{camera}/sensor.yaml").unlink()
    assert "sensor.yaml is missing" in refused([folder], tmp_path / "o" / "s")
    imported([folder], tmp_path / "back", **chain(data, tmp_path))
    require_same(data, tmp_path / "back")


def test_millimetres_of_any_calibration(data: Original, tmp_path: Path) -> None:
    """As the warning advises."""
    folders, chain_mm = write_folders(data, tmp_path / "images"), tmp_path / "mm.yaml"
    text = write_kalibr(data, tmp_path / "k.yaml").read_text()
    chain_mm.write_text(text.replace(repr(float(data.X_10[0, 3])), repr(1e3 * float(data.X_10[0, 3]))))
    assert "give --unit mm" in imported(folders, tmp_path / "m", calibration=(chain_mm,)).warnings[0]
    done = imported(folders, tmp_path / "mm", calibration=(chain_mm,), unit_m=1e-3)
    assert done.warnings == () and done.understood["baseline"] == "0.09 m"


def test_a_dry_run_shows_what_is_understood_and_writes_nothing(
    data: Original, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = write_folders(data, tmp_path / "images", 4_000)
    words = ["import", str(left), str(right), "--calibration", str(write_kalibr(data, tmp_path / "k.yaml"))]
    before = sorted(tmp_path.rglob("*"))
    assert main([*words, "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert sorted(tmp_path.rglob("*")) == before and "nothing written" in printed
    assert main([*words, "-o", str(tmp_path / "back")]) == 0
    record = json.loads((tmp_path / "back" / "import.json").read_text())["understood"]
    for name, text in record.items():
        assert f"{name} " in printed and text in printed
    assert record["times"].startswith("6 pairs, 0.5 s apart, 2.5 s, from ")
    assert record["left camera"].startswith("64x48 px, 65.2 x 50.4 deg, focal length 50 px")
    assert (record["offset of the right clock"], record["left out"]) == ("4 us ahead", "nothing")
    assert main(words) == 2 and "-o is missing" in capsys.readouterr().err


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_images_are_imported_with_the_calibration_of_each_program(
    program: str, data: Original, tmp_path: Path
) -> None:
    folders = write_folders(data, tmp_path / "images")
    if program == "ZED":
        for path in (path for folder in folders for path in folder.iterdir()):
            Image.open(path).resize((672, 376)).save(path)
    done = imported(folders, tmp_path / "back", calibration=tuple(PROGRAMS[program](data, tmp_path)))
    assert done.understood["baseline"] == "0.09 m" and done.pairs == 6


FAULTS = {
    "milliseconds as nanoseconds": "usual interval between pairs",
    "days as seconds": "usual interval between pairs",
    "microseconds as milliseconds": "interval over that of rate_hz in sensor.yaml",
    "a baseline in millimetres": "baseline",
    "swapped cameras": "pairs with left and right exchanged",
    "a mirrored pair": "pairs with left and right exchanged",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_contradicts_fails_in_checkout(fault: str, rendered_sequence: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sequence"
    shutil.copytree(rendered_sequence, folder, ignore=shutil.ignore_patterns("truth*", "state_groundtruth*"))
    mav0, sequence = folder / "mav0", open_sequence(rendered_sequence)
    rig = sequence.calibration
    scale = {"milliseconds as nanoseconds": 1e-6, "days as seconds": 1e5, "microseconds as milliseconds": 1e3}
    if (factor := scale.get(fault)) is not None:
        since_ns = sequence.timestamps_ns - sequence.timestamps_ns[0]
        stamps = [round(factor * stamp) for stamp in since_ns.tolist()]
        for camera in (0, 1):
            files = sorted((mav0 / f"cam{camera}/data").iterdir(), key=lambda path: int(path.stem))
            for stamp, path in zip(stamps, files, strict=True):
                path.rename(path.with_name(f"new{stamp}.png"))
            for path in (mav0 / f"cam{camera}/data").iterdir():
                path.rename(path.with_name(path.name.removeprefix("new")))
            write_camera_csv(mav0 / f"cam{camera}", np.array(stamps))
        shutil.rmtree(mav0 / "inspector0", ignore_errors=True)
    if fault == "a baseline in millimetres":
        X_BC1 = rig.X_BC1.copy()
        X_BC1[:3, 3] = rig.X_BC0[:3, 3] + 1e3 * (rig.X_BC1 - rig.X_BC0)[:3, 3]
        write_sensor(mav0 / "cam1", rig.K1, rig.dist1, X_BC1, rig.size_px(1), rate_hz=2.0, bits=8)
    if fault == "swapped cameras":
        for old, new in (("cam0/data", "kept"), ("cam1/data", "cam0/data"), ("kept", "cam1/data")):
            (mav0 / old).rename(mav0 / new)
    if fault == "a mirrored pair":
        for path in mav0.glob("cam?/data/*.png"):
            Image.fromarray(np.asarray(Image.open(path))[:, ::-1]).save(path)
    result = checkout(folder, workers=1, count=3).result
    failed = [check.name for check in result.checks if check.status == "FAIL"]
    assert FAULTS[fault] in failed and result.status == "FAIL"
