"""Faulty sequences, made from a simulated one whose rig is ideal: what checkout must find."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.robustness import faults_of_files as files
from benchmarks.robustness.recording import Images, Recording, read_recording, write_recording
from polhode.dataset_writer import image_path, write_camera_csv
from polhode.lie import exp_so3
from polhode.records import Ints

FRAMES = 16
"""Of the sound sequence that a faulty one is made from."""


@dataclass(frozen=True)
class Fault:
    """One fault."""

    title: str
    change: files.Change
    found_by: str
    """Name of the check that must not pass"""
    stamps: Callable[[Ints], Ints] | None = None
    """Of the right camera, from those of the left; None: the same"""


def tilted(axis: tuple[float, float, float], degrees: float) -> files.Change:
    """The right camera is turned about an axis of its own, throughout; the calibration stays."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        K = recording.true_K
        H = K @ exp_so3(np.deg2rad(degrees) * np.array(axis)) @ np.linalg.inv(K)
        size = (recording.right.shape[2], recording.right.shape[1])
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        return replace(
            recording,
            right=np.stack([cv2.warpPerspective(each, H, size, flags=flags) for each in recording.right]),
        )

    return change


def darker(factor: float) -> files.Change:
    """All images so many times darker, with the noise of the sensor."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        def dark(images: Images) -> Images:
            values = images * factor + files.READ_NOISE_DN * rng.standard_normal(images.shape)
            return np.asarray(np.clip(np.rint(values), 0, 255), dtype=np.uint8)

        return replace(recording, left=dark(recording.left), right=dark(recording.right))

    return change


def noisy(levels: float) -> files.Change:
    """Noise of so many grey levels."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        def more(images: Images) -> Images:
            values = images + levels * rng.standard_normal(images.shape)
            return np.asarray(np.clip(np.rint(values), 0, 255), dtype=np.uint8)

        return replace(recording, left=more(recording.left), right=more(recording.right))

    return change


def smeared(length_px: int) -> files.Change:
    """Motion blur along the rows."""
    kernel = np.full((1, length_px), 1.0 / length_px)

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        del rng
        return replace(
            recording,
            left=np.stack([cv2.filter2D(each, -1, kernel) for each in recording.left]),
            right=np.stack([cv2.filter2D(each, -1, kernel) for each in recording.right]),
        )

    return change


def every(step: int) -> files.Change:
    """Only each ``step``-th frame."""
    return lambda recording, rng: recording.kept(np.arange(0, len(recording), step))


def right_out_of_focus(recording: Recording, rng: np.random.Generator) -> Recording:
    """The right images have a blur of 2 px."""
    return replace(recording, right=files.blur(recording, rng).right)


def right_darker(recording: Recording, rng: np.random.Generator) -> Recording:
    """The right camera exposes for half the time."""
    return replace(recording, right=darker(0.5)(recording, rng).right)


def exchanged(recording: Recording, rng: np.random.Generator) -> Recording:
    """Left and right images are exchanged throughout."""
    del rng
    return replace(recording, left=recording.right, right=recording.left)


def before_a_wall(recording: Recording, rng: np.random.Generator) -> Recording:
    """A grey wall with some texture stands behind the target."""
    wall = cv2.GaussianBlur(rng.uniform(0.0, 255.0, recording.left.shape[1:]), (0, 0), 4.0)
    wall = 70.0 + 4.0 * (wall - wall.mean())

    def filled(images: Images) -> Images:
        out = [
            np.where(cv2.GaussianBlur(each, (0, 0), 1.5) > 8, each, np.clip(wall, 20, 200)) for each in images
        ]
        return np.stack(out).astype(np.uint8)

    return replace(recording, left=filled(recording.left), right=filled(recording.right))


def unchanged(recording: Recording, rng: np.random.Generator) -> Recording:
    """As it is."""
    del rng
    return recording


FAULTS: Mapping[str, Fault] = {
    "pitch": Fault("right camera 0.2 deg up", tilted((1.0, 0.0, 0.0), 0.2), "pitch of the right camera"),
    "small_pitch": Fault(
        "right camera 0.05 deg up", tilted((1.0, 0.0, 0.0), 0.05), "pitch of the right camera"
    ),
    "roll": Fault("right camera turned by 0.4 deg", tilted((0.0, 0.0, 1.0), 0.4), "roll of the right camera"),
    "yaw": Fault("right camera 0.2 deg sideways", tilted((0.0, 1.0, 0.0), 0.2), ""),
    "exchanged": Fault("left and right exchanged", exchanged, "pairs with left and right exchanged"),
    "clocks": Fault("stamps 4 us apart", unchanged, "clock offset of the right camera", lambda t: t + 4_000),
    "few_frames": Fault("every second frame", every(2), "rotation between successive frames"),
    "gap": Fault("4 s lost", files.burst(4.0), "longest gap"),
    "blur": Fault("2 px of blur", files.blur, "width of edges"),
    "right_blur": Fault(
        "the right camera out of focus",
        right_out_of_focus,
        "ratio of the widths of edges between the cameras",
    ),
    "smeared": Fault("7 px of motion blur", smeared(7), "ratio of the widths of edges between directions"),
    "saturation": Fault("exposed four times too long", files.saturation, "saturated part of the target"),
    "dark": Fault("a tenth of the light", darker(0.1), "99.5th percentile of the grey levels of the target"),
    "right_dark": Fault(
        "right camera with half the light", right_darker, "difference of brightness between the cameras"
    ),
    "noise": Fault("noise of 12 grey levels", noisy(12.0), "noise after the contrast is stretched"),
    "wall": Fault("a wall behind the target", before_a_wall, "bright part of the border of the image"),
}
"""No check finds a yaw: rows do not show it."""


def write_faulty(source: Path, fault: Fault, folder: Path) -> None:
    """The beginning of a sequence, with the fault; random numbers are the same in every call."""
    beginning = read_recording(source).kept(np.arange(FRAMES))
    recording = fault.change(beginning, np.random.default_rng(7))
    write_recording(recording, folder)
    if fault.stamps is None:
        return
    camera, stamps = folder / "mav0" / "cam1", fault.stamps(recording.stamps_ns)
    for old, new in zip(recording.stamps_ns, stamps, strict=True):
        image_path(camera, int(old)).rename(image_path(camera, int(new)))
    write_camera_csv(camera, stamps)
