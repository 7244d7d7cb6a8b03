"""Opening sequences: what is read, what is dropped with a warning, and each bad input's one line."""

import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from polhode.geometry.lie import exp_so3, make_pose
from polhode.records import dataset
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import (
    image_path,
    write_camera_csv,
    write_inspector,
    write_png,
    write_wrench,
)
from polhode.runtime.errors import InputError

START_NS, STEP_NS, COUNT = 1_600_000_000_000_000_000, 500_000_000, 6
STAMPS = [START_NS + k * STEP_NS for k in range(COUNT)]


def image_of(folder: Path, camera: int, k: int) -> Path:
    return image_path(folder / "mav0" / f"cam{camera}", STAMPS[k])


def truncate(path: Path, share: float = 0.5) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])


def message_of(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_sequence(folder)
    message = str(caught.value)
    assert "\n" not in message
    return message


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_good_sequence_is_read_whole(small_sequence: Path) -> None:
    sequence = open_sequence(small_sequence)
    assert sequence.timestamps_ns.tolist() == STAMPS
    assert (len(sequence), sequence.n_listed, sequence.dropped, sequence.warnings) == (COUNT, COUNT, (), ())
    calibration = sequence.calibration
    np.testing.assert_array_equal(calibration.K0, [[50.0, 0.0, 31.5], [0.0, 51.0, 23.5], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(calibration.dist1, [-0.1, 0.01, 0.0, 0.0])
    np.testing.assert_array_equal(calibration.X_BC1[:3, 3], [0.09, 0.0, 0.0])
    assert (calibration.width_px, calibration.height_px) == (64, 48)
    pair = sequence.read_pair(3)
    np.testing.assert_array_equal(pair.left, np.asarray(Image.open(image_of(small_sequence, 0, 3))))
    np.testing.assert_array_equal(sequence.read_left(3)[0], pair.left)
    np.testing.assert_array_equal(pair.right, np.asarray(Image.open(image_of(small_sequence, 1, 3))))
    assert pair.mask_left is None and pair.mask_right is None
    # without inspector0, N is the left camera at rest
    np.testing.assert_array_equal(sequence.X_NC, np.tile(np.eye(4), (COUNT, 1, 1)))
    assert not sequence.inspector_moves
    assert sequence.sigma_camera_p_m == sequence.sigma_camera_theta_rad == 0.0 and sequence.wrench is None
    write_wrench(small_sequence / "mav0", np.array(STAMPS[:1]), np.ones((1, 3)), np.zeros((1, 3)))
    wrench = open_sequence(small_sequence).wrench
    assert wrench is not None
    np.testing.assert_array_equal(wrench.force_N, np.ones((1, 3)))
    with pytest.raises(InputError, match=r"mav0 is the folder mav0 itself: give the folder that contains it"):
        open_sequence(small_sequence / "mav0")


def test_cameras_of_two_resolutions_and_a_fisheye_are_read(small_sequence: Path) -> None:
    mav0 = small_sequence / "mav0"
    edit(mav0 / "cam1" / "sensor.yaml", "[64, 48]", "[96, 80]")
    edit(mav0 / "cam1" / "sensor.yaml", "radial-tangential", "equidistant")
    for k in range(COUNT):
        with Image.open(image_of(small_sequence, 1, k)) as image:
            larger = np.asarray(image.resize((96, 80)))
        write_png(image_of(small_sequence, 1, k), larger)
        for camera, (width, height) in enumerate(((64, 48), (96, 80))):
            write_png(mav0 / f"masks{camera}" / f"{STAMPS[k]}.png", np.ones((height, width), dtype=np.bool_))
    sequence = open_sequence(small_sequence)
    calibration = sequence.calibration
    assert (calibration.size_px(0), calibration.size_px(1)) == ((64, 48), (96, 80))
    assert (calibration.fisheye0, calibration.fisheye1) == (False, True)
    np.testing.assert_array_equal(calibration.dist1, [-0.1, 0.01, 0.0, 0.0])
    pair = sequence.read_pair(2)
    assert (pair.left.shape, pair.right.shape) == ((48, 64), (80, 96))
    assert pair.mask_left is not None and pair.mask_right is not None
    assert (pair.mask_left.shape, pair.mask_right.shape) == ((48, 64), (80, 96))
    write_png(mav0 / "masks1" / f"{STAMPS[0]}.png", np.ones((48, 64), dtype=np.bool_))
    assert "masks must have the size of the images" in message_of(small_sequence)


def test_missing_damaged_small_and_unpaired_frames_are_dropped_and_counted(small_sequence: Path) -> None:
    image_of(small_sequence, 0, 0).unlink()
    truncate(image_of(small_sequence, 1, 2))
    write_camera_csv(small_sequence / "mav0" / "cam1", STAMPS[:5])
    sequence = open_sequence(small_sequence)
    # Of 6 frames 3 lost is half: the run goes on.
    assert sequence.timestamps_ns.tolist() == [STAMPS[1], STAMPS[3], STAMPS[4]]
    assert sequence.n_listed == COUNT
    assert sequence.dropped == (
        (STAMPS[0], "cam0 image: file missing"),
        (STAMPS[2], "cam1 image: damaged or truncated"),
        (STAMPS[5], "only in cam0"),
    )
    (warning,) = sequence.warnings
    assert warning.startswith("3 of 6 frames dropped")
    write_png(image_of(small_sequence, 1, 2), np.full((24, 32), 200, dtype=np.uint8))
    dropped = open_sequence(small_sequence).dropped
    assert dropped[1] == (STAMPS[2], "cam1 image: wrong size, 32x24 px instead of 64x48 px")


def write_12_bits(folder: Path, divisors: Callable[[int], int], bits: int | None = None) -> None:
    """The images, darkened by frame, as a 12-bit sensor writes them; ``bits`` in sensor.yaml."""
    for camera in (0, 1):
        for k in range(COUNT):
            codes = np.asarray(Image.open(image_of(folder, camera, k))) // divisors(k)
            write_png(image_of(folder, camera, k), codes.astype(np.uint16) * np.uint16(16))
        if bits is not None:
            path = folder / "mav0" / f"cam{camera}" / "sensor.yaml"
            path.write_text(f"{path.read_text()}bits: {bits}\n")


def test_sixteen_bit_images_are_scaled_by_one_factor_for_the_whole_sequence(
    small_sequence: Path, tmp_path: Path
) -> None:
    grey = [np.asarray(Image.open(image_of(small_sequence, 0, k))) for k in (0, 1)]
    dark = Path(shutil.copytree(small_sequence, tmp_path / "dark"))
    # only some frames reach the upper half
    write_12_bits(small_sequence, lambda k: 1 if k else 4)
    sequence = open_sequence(small_sequence)
    np.testing.assert_array_equal(sequence.read_pair(1).left, grey[1])
    np.testing.assert_array_equal(sequence.read_pair(0).left, grey[0] // 4)
    # a dark 12-bit sequence that tells its depth is not taken for a 10-bit one
    write_12_bits(dark, lambda k: 8, bits=12)
    np.testing.assert_array_equal(open_sequence(dark).read_pair(1).left, grey[1] // 8)


def test_colours_other_names_comments_blank_lines_folders_and_links_are_read(small_sequence: Path) -> None:
    camera = small_sequence / "mav0" / "cam0"
    grey = np.asarray(Image.open(image_of(small_sequence, 0, 1)))
    write_png(image_of(small_sequence, 0, 1), np.repeat(grey[..., None], 3, axis=-1))
    (camera / "data" / "below").mkdir()
    lines = ["# my rig", "#timestamp [ns],filename", ""]
    for k, stamp in enumerate(STAMPS):
        name = "below/a.png" if k == 0 else f"left {k}.png"
        image_of(small_sequence, 0, k).rename(camera / "data" / name)
        lines.append(f" {stamp} , {name} ")
    (camera / "data.csv").write_text("\r\n".join(lines))
    (camera / "data").rename(small_sequence / "elsewhere")
    (camera / "data").symlink_to(small_sequence / "elsewhere")
    sequence = open_sequence(small_sequence)
    assert len(sequence) == COUNT
    np.testing.assert_array_equal(sequence.read_pair(1).left, grey)


def test_masks_are_read_where_they_exist(small_sequence: Path) -> None:
    mask = np.zeros((48, 64), dtype=np.bool_)
    mask[12:36, 20:44] = True
    for stamp in STAMPS[1:]:
        write_png(small_sequence / "mav0" / "masks0" / f"{stamp}.png", mask)
    # Labels other than 255 count: non-zero is the target.
    write_png(small_sequence / "mav0" / "masks0" / f"{STAMPS[2]}.png", mask.astype(np.uint8))
    sequence = open_sequence(small_sequence)
    assert sequence.read_pair(0).mask_left is None
    for k in (1, 2):
        found = sequence.read_pair(k).mask_left
        assert found is not None
        np.testing.assert_array_equal(found, mask)
    assert sequence.read_pair(1).mask_right is None
    (warning,) = sequence.warnings
    assert warning.startswith("1 masks are missing or unreadable")


def test_inspector_poses_are_interpolated_and_composed_with_the_camera(small_sequence: Path) -> None:
    X_BC0 = make_pose(exp_so3([0.1, -0.2, 0.3]), [0.02, 0.03, 0.04])
    edit(small_sequence / "mav0" / "cam0" / "sensor.yaml", IDENTITY, str(X_BC0.ravel().tolist()))
    # A screw motion, sampled 40 ms beside the frames: linear interpolation and slerp are exact on it.
    offset_ns = 40_000_000
    poses_ns = np.array([STAMPS[0] - STEP_NS, *STAMPS, STAMPS[-1] + STEP_NS], dtype=np.int64) + offset_ns

    def X_NB(stamps_ns: np.ndarray) -> np.ndarray:
        t_s = (stamps_ns - START_NS) * 1e-9
        return make_pose(exp_so3(t_s[:, None] * [0.05, 0.1, -0.2]), t_s[:, None] * [0.01, -0.02, 0.03])

    write_inspector(small_sequence / "mav0", poses_ns, X_NB(poses_ns), sigma_p_m=1e-3, sigma_theta_rad=2e-3)
    sequence = open_sequence(small_sequence)
    np.testing.assert_allclose(sequence.X_NC, X_NB(np.array(STAMPS)) @ X_BC0, atol=1e-12)
    assert sequence.inspector_moves and sequence.warnings == ()
    assert (sequence.sigma_camera_p_m, sequence.sigma_camera_theta_rad) == (1e-3, 2e-3)


def test_a_still_inspector_does_not_move_and_a_missing_pose_is_interpolated(small_sequence: Path) -> None:
    X_NB = np.tile(make_pose(exp_so3([0.4, 0.0, 0.0]), [1.0, 2.0, 3.0]), (COUNT, 1, 1))
    write_inspector(small_sequence / "mav0", np.array(STAMPS), X_NB)
    (small_sequence / "mav0" / "inspector0" / "sensor.yaml").unlink()
    sequence = open_sequence(small_sequence)
    assert not sequence.inspector_moves and sequence.sigma_camera_p_m == 0.0
    np.testing.assert_allclose(sequence.X_NC, X_NB, atol=1e-12)
    write_inspector(small_sequence / "mav0", np.delete(np.array(STAMPS), 2), X_NB[1:])
    assert "1 frames lack a pose" in open_sequence(small_sequence).warnings[0]


Damage = Callable[[Path], None]


def remove(*parts: str) -> Damage:
    def damage(folder: Path) -> None:
        path = folder.joinpath(*parts)
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return damage


def replace(name: str, old: str, new: str) -> Damage:
    return lambda folder: edit(folder / "mav0" / name, old, new)


def rewrite(name: str, content: str | bytes) -> Damage:
    def damage(folder: Path) -> None:
        (folder / "mav0" / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return damage


def put(name: str, what: str) -> Damage:
    """Something that is no regular file in the place of a file."""
    make: dict[str, Callable[[Path], object]] = {
        "a device": lambda path: path.symlink_to("/dev/zero"), "a pipe": os.mkfifo, "a folder": Path.mkdir,
        "a socket": lambda path: os.mknod(path, stat.S_IFSOCK | 0o600),
    }  # fmt: skip

    def damage(folder: Path) -> None:
        path = folder / "mav0" / name
        path.parent.mkdir(exist_ok=True)
        path.unlink(missing_ok=True)
        make[what](path)

    return damage


def rows(stamps: list[int]) -> str:
    return "#timestamp [ns],filename\n" + "".join(f"{stamp},{stamp}.png\n" for stamp in stamps)


def damage_images(count: int) -> Damage:
    def damage(folder: Path) -> None:
        for k in range(count):
            truncate(image_of(folder, k % 2, k))

    return damage


def write_all(images: Callable[[], np.ndarray], cameras: tuple[int, ...] = (0, 1)) -> Damage:
    def damage(folder: Path) -> None:
        for camera in cameras:
            for k in range(COUNT):
                write_png(image_of(folder, camera, k), images())

    return damage


def black() -> np.ndarray:
    noise = np.random.default_rng(1).normal(1.0, 2.0, (48, 64)).clip(0, 255).astype(np.uint8)
    noise[5, 7] = 255
    return np.asarray(noise)


def list_two_pairs(folder: Path) -> None:
    for camera in (0, 1):
        write_camera_csv(folder / "mav0" / f"cam{camera}", STAMPS[:2])


def small_mask(folder: Path) -> None:
    write_png(folder / "mav0" / "masks1" / f"{STAMPS[1]}.png", np.ones((24, 32), dtype=np.bool_))


def inspector(stamps: list[int], old: str = "", new: str = "") -> Damage:
    def damage(folder: Path) -> None:
        X_NB = make_pose(np.tile(np.eye(3), (len(stamps), 1, 1)), np.full((len(stamps), 3), 0.625))
        write_inspector(folder / "mav0", np.array(stamps, dtype=np.int64), X_NB)
        if old:
            edit(folder / "mav0" / "inspector0" / "data.csv", old, new)

    return damage


def with_inspector(damage: Damage) -> Damage:
    def both(folder: Path) -> None:
        inspector(STAMPS)(folder)
        damage(folder)

    return both


def sensor(key: str, value: object, cameras: tuple[int, ...] = (0, 1)) -> Damage:
    """Another value of a key of sensor.yaml."""

    def damage(folder: Path) -> None:
        for camera in cameras:
            path = folder / "mav0" / f"cam{camera}" / "sensor.yaml"
            path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {key: value}))

    return damage


IDENTITY = "[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]"
ROTATED = "[1.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]"
CAM0, CAM1, DIST = "cam0/sensor.yaml", "cam1/sensor.yaml", "distortion_coefficients"
BETWEEN = [stamp + STEP_NS // 2 for stamp in STAMPS]
# fmt: off
BAD: dict[str, tuple[Damage, str]] = {
    "no folder": (remove(), "is not a folder"),
    "no mav0": (remove("mav0"), "mav0/cam0 is missing"),
    "no cam1": (remove("mav0", "cam1"), "mav0/cam1 is missing"),
    "no calibration": (remove("mav0", "cam1", "sensor.yaml"), "a camera needs its calibration"),
    "empty calibration": (rewrite(CAM0, ""), "has no keys"),
    "broken yaml": (rewrite(CAM0, "a: [1\nb: 2"), "sensor.yaml line 2: not valid YAML"),
    "no intrinsics": (replace(CAM0, "intrinsics", "intrinsic"), "lacks the key 'intrinsics'"),
    "no distortion": (replace(CAM1, "distortion_model", "model"), "lacks the key 'distortion_model'"),
    "unknown lens": (sensor("distortion_model", "double-sphere"), "'double-sphere' is not supported"),
    "nan intrinsics": (replace(CAM0, "[50.0", "[.nan"), "'intrinsics': contains NaN or infinity"),
    "negative focal": (replace(CAM0, "[50.0", "[-50.0"), "focal lengths must be positive"),
    "no rotation": (replace(CAM0, IDENTITY, ROTATED), "'T_BS': not a rigid transform"),
    "no baseline": (replace(CAM1, "0.09", "0.0"), "coincide"),
    "a fisheye with five coefficients": (
        lambda folder: (sensor("distortion_model", "fisheye")(folder), sensor(DIST, [0.1] * 5)(folder))[1],
        "distortion_coefficients': 5 numbers, expected 4"),
    "one camera tells bits": (sensor("bits", 12, (1,)), "cam0 and cam1 differ, None and"),
    "too few bits": (lambda folder: write_12_bits(folder, lambda k: 1, 10), "is above 10 bits: correct"),
    "no list": (remove("mav0", "cam0", "data.csv"), "data.csv is missing"),
    "time goes back": (rewrite("cam0/data.csv", rows(STAMPS[:3] + STAMPS[1:])), "line 5: timestamp"),
    "time in seconds": (rewrite("cam1/data.csv", "1.5,a.png\n"), "not a whole number of nanoseconds"),
    "most images lost": (damage_images(4), "4 of 6 frames are missing, unpaired or unreadable"),
    "all of wrong size": (write_all(lambda: np.full((10, 10), 99, np.uint8), (0,)), "wrong size, 10x10 px"),
    "no common times": (rewrite("cam1/data.csv", rows(BETWEEN)), "12 of 12 frames are missing, unpaired"),
    "two pairs": (list_two_pairs, "2 usable stereo pairs of 2 frames; at least 3 are needed"),
    "black": (write_all(black), "all frames are black"),
    "white": (write_all(lambda: np.full((48, 64), 255, np.uint8)), "all frames are saturated or uniformly"),
    "mask of wrong size": (small_mask, "wrong size, 32x24 px instead of 64x48 px; masks must have"),
    "nan inspector": (inspector(STAMPS, "0.625", "nan"), "line 2: NaN or infinity"),
    "inspector ends early": (inspector(STAMPS[:3]), "does not cover 2 of 6 frames"),
    "inspector starts late": (inspector(STAMPS[4:]), "does not cover 3 of 6 frames"),
    "inspector not unit": (inspector(STAMPS, "1.0,0.0,0.0,0.0", "1.0,1.0,0.0,0.0"), "not a unit quaternion"),
    "inspector at 1e300": (inspector(STAMPS, "0.625", "1e300"), "1e+300 is no value of a coordinate"),
    "negative sigma": (with_inspector(rewrite("inspector0/sensor.yaml", "sigma_p_m: -1")), "is negative"),
    "sigma 1e9": (with_inspector(rewrite("inspector0/sensor.yaml", "sigma_p_m: 1.0e+9")), "poses say noth"),
    # no lens has these
    "focal length 1e-3": (sensor("intrinsics", [0.001, 50, 32, 24]), "expected 1.28 to 640000 px"),
    "pixels 100 times as wide as high": (sensor("intrinsics", [50, 5000, 32, 24]), "differ by more than"),
    "principal point 1e300": (sensor("intrinsics", [50, 50, 1e300, 24]), "principal point (1e+300"),
    "resolution 0": (sensor("resolution", [0, 48]), "expected [width, height] in whole pixels"),
    "resolution 1e5": (sensor("resolution", [100000, 48]), "sides may have 16 to 32000"),
    "resolution 1e8": (sensor("resolution", [10000, 10000]), "the image 64 million"),
    "distortion 1e300": (sensor(DIST, [1e300, 0, 0, 0]), "is above 1e+07"),
    "T_BS 1e300": (sensor("T_BS", [[1e300] * 4] * 4), "'T_BS': 1e+300 is above 10000"),
    "T_BS of zeros": (sensor("T_BS", [0.0] * 16), "'T_BS': not a rigid transform"),
    "bits 1e9": (sensor("bits", 10**9), "8 to 16, got 1000000000"),
    "model a list": (sensor("camera_model", [0] * 1000), "is not supported; use pinhole"),
    # hostile
    "a device as list": (put("cam0/data.csv", "a device"), "data.csv is a device: give a regular file"),
    "a pipe as calibration": (put(CAM1, "a pipe"), "sensor.yaml is a pipe: give a regular file"),
    "a socket as poses": (put("inspector0/data.csv", "a socket"), "data.csv is a socket: give a regular"),
    "a folder as wrench": (put("wrench0/data.csv", "a folder"), "data.csv is a folder: give a regular file"),
    "a device as noise of poses": (with_inspector(put("inspector0/sensor.yaml", "a device")),
        "sensor.yaml is a device: give a regular file"),
    "endless aliases": (rewrite(CAM0, "a: &a [*a]"), "sensor.yaml line 1: an alias stands for a"),
    "UTF-16 list": (rewrite("cam0/data.csv", rows(STAMPS).encode("utf-16")), "not UTF-8 text"),
    "absolute path": (rewrite("cam0/data.csv", f"{STAMPS[0]},/etc/passwd\n"),
        "data.csv line 1: the name '/etc/passwd' leads out of the dataset"),
    "key twice": (replace(CAM0, "intrinsics", "resolution"), "key 'resolution' is given twice"),
}
# fmt: on


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_that_names_the_place(small_sequence: Path, name: str) -> None:
    damage, expected = BAD[name]
    damage(small_sequence)
    message = message_of(small_sequence)
    assert expected in message and str(small_sequence) in message
    assert len(message) < 400 + len(str(small_sequence))


def test_a_sequence_that_is_mostly_missing_or_damaged_is_not_read_to_its_end(
    small_sequence: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset, "PAIRS_AHEAD", 2)
    damage_images(5)(small_sequence)
    assert "at least 4 of 6 frames are missing, unpaired or unreadable" in message_of(small_sequence)
    for camera in (0, 1):
        write_camera_csv(small_sequence / "mav0" / f"cam{camera}", [START_NS + k for k in range(2000)])
    assert "1999 of 2000 frames are missing" in message_of(small_sequence)


@pytest.mark.parametrize("camera", [0, 1])
def test_an_image_that_disappears_or_becomes_another_one_later_is_noticed(
    camera: int, small_sequence: Path
) -> None:
    sequence = open_sequence(small_sequence)
    shutil.copy(image_of(small_sequence, camera, 3), image_of(small_sequence, camera, 2))
    image_of(small_sequence, camera, 0).unlink()
    sequence.read_pair(1)
    with pytest.raises(InputError, match=f"{STAMPS[2]}.png: changed while in use"):
        sequence.read_pair(2)
    with pytest.raises(InputError, match="changed while in use: file missing"):
        sequence.read_pair(0)


@pytest.mark.parametrize(
    ("new", "expected"),
    [
        (lambda k: 1600000000 + k, "the frames are 1e-09 s apart: check that the timestamps in data.csv"),
        (lambda k: k * 10**15, "the frames are 1e+06 s apart: check that the timestamps in data.csv"),
        (lambda k: START_NS + k * STEP_NS + (k == 5) * 10**18, "s after the one before it, where"),
        # an eclipse of half an hour
        (lambda k: START_NS + k * STEP_NS + (k > 2) * 1800 * 10**9, None),
    ],
)
def test_odd_times_are_warned_about(
    small_sequence: Path, new: Callable[[int], int], expected: str | None
) -> None:
    for camera in (0, 1):
        table = small_sequence / "mav0" / f"cam{camera}" / "data.csv"
        head, *lines = table.read_text().splitlines()
        restamped = [f"{new(k)},{line.split(',', 1)[1]}" for k, line in enumerate(lines)]
        table.write_text("\n".join([head, *restamped]) + "\n")
    warnings = open_sequence(small_sequence).warnings
    assert warnings == () if expected is None else expected in " ".join(warnings) and len(warnings) == 1


def repeat(folder: Path, camera: int, frames: list[int]) -> None:
    """Images that are copies of those before them."""
    for k in frames:
        image_of(folder, camera, k).write_bytes(image_of(folder, camera, k - 1).read_bytes())


def test_pairs_that_repeat_the_one_before_are_not_measured(small_sequence: Path) -> None:
    repeat(small_sequence, 0, [3, 4])
    repeat(small_sequence, 1, [4])
    sequence = open_sequence(small_sequence)
    assert len(sequence) == COUNT and sequence.repeated.tolist() == [False] * 3 + [True] * 2 + [False]
    (warning,) = sequence.warnings
    assert "2 of 6 pairs have an image of the pair before, bit for bit" in warning and not sequence.frozen
    for k in range(COUNT):
        pair = sequence.read_pair(k)
        for mask in (pair.mask_left, pair.mask_right):
            assert (mask is not None and not mask.any()) == (k in (3, 4))
    # a recorder that stood still throughout
    repeat(small_sequence, 1, list(range(1, COUNT)))
    assert "cam1: all images are the same, bit for bit" in message_of(small_sequence)
    repeat(small_sequence, 0, list(range(1, COUNT)))
    sequence = open_sequence(small_sequence)
    # Renderings of a target at rest look like this: they are used, and called doubtful.
    assert sequence.frozen and not sequence.repeated.any() and sequence.warnings == ()


def shift_right(folder: Path, offset_ns: int | list[int]) -> None:
    """Give the right images stamps of another clock."""
    shifts = [offset_ns] * COUNT if isinstance(offset_ns, int) else offset_ns
    rows = [f"{stamp + off},{stamp}.png" for stamp, off in zip(STAMPS, shifts, strict=True)]
    path = folder / "mav0" / "cam1" / "data.csv"
    path.write_text("\n".join(["#timestamp [ns],filename", *rows]) + "\n")


@pytest.mark.parametrize(
    ("offset_ns", "words"),
    [(4_000, "4 us (8e-06 frames) after"), (-200_000_000, "0.2 s (0.4 frames) before")],
)
def test_an_offset_of_the_clocks_loses_no_frame_and_is_stated(
    small_sequence: Path, offset_ns: int, words: str
) -> None:
    alike = open_sequence(small_sequence)
    shift_right(small_sequence, offset_ns)
    # masks of the right camera may have the stamps of its images
    mask = np.zeros((48, 64), dtype=np.bool_)
    mask[10:20] = True
    for k, stamp in enumerate(STAMPS):
        write_png(small_sequence / "mav0" / "masks1" / f"{stamp + offset_ns * (k % 2)}.png", mask)
    sequence = open_sequence(small_sequence)
    assert sequence.timestamps_ns.tolist() == STAMPS and sequence.dropped == ()
    (warning,) = sequence.warnings
    assert warning.startswith(f"the stamps of cam1 are {words} those of cam0")
    for k in range(COUNT):
        np.testing.assert_array_equal(sequence.read_pair(k).right, alike.read_pair(k).right)
        np.testing.assert_array_equal(sequence.read_pair(k).mask_right, mask)


def test_a_pair_beyond_the_tolerance_is_dropped_with_its_distance(small_sequence: Path) -> None:
    shift_right(small_sequence, [0, 0, 12_500_000, 0, 0, 0])
    sequence = open_sequence(small_sequence)
    assert len(sequence) == COUNT - 1 and sequence.n_listed == COUNT + 1
    first, second = sequence.dropped
    assert first[1].startswith("only in cam0: the nearest image of cam1 is 12.5 ms away, 5 ms are allowed")
    assert second == (STAMPS[2] + 12_500_000, "only in cam1")
    shift_right(small_sequence, 3_600_000_000_000)
    assert "no time in common: cam1 begins 3598 s after cam0 ends" in message_of(small_sequence)
