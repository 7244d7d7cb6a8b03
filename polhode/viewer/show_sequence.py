"""A sequence in Rerun, as recorded: images, outlines of the masks, the rig, the inspector's poses."""

from collections.abc import Iterator
from pathlib import Path

from polhode.records.dataset import StereoSequence, open_sequence
from polhode.runtime.progress import Progress
from polhode.viewer.blueprint import Eyes, arrangement, beside_camera
from polhode.viewer.shown_frame import ShownFrame, ShownRig
from polhode.viewer.target import ViewTarget


def show_sequence(sequence_folder: Path, target: ViewTarget, progress: Progress) -> None:
    """Show a sequence. Raises InputError as ``open_sequence``."""
    sequence = open_sequence(sequence_folder)
    rig = ShownRig.recorded(sequence.calibration)
    blueprint = arrangement(
        Eyes(beside_camera(sequence.X_NC[0], rig.plane_m)),
        has_motion=False,
        landmarks_add_up=True,
        has_right=not sequence.has_ranges,
    )
    opened = target.opened(sequence_folder.resolve().name, rig, blueprint)
    with opened as recorder, progress.stage("recording", len(sequence)) as advance:
        for frame in recorded_frames(sequence):
            recorder.log_frame(frame)
            advance()


def recorded_frames(sequence: StereoSequence) -> Iterator[ShownFrame]:
    """Every pair of a sequence; of one with range images the left images alone."""
    for k in range(len(sequence)):
        pair = sequence.read_pair(k)
        yield ShownFrame(
            number=k,
            time_s=1e-9 * int(sequence.timestamps_ns[k] - sequence.timestamps_ns[0]),
            X_NL=sequence.X_NC[k],
            left=pair.left,
            right=None if sequence.has_ranges else pair.right,
            mask_left=pair.mask_left,
            mask_right=None if sequence.has_ranges else pair.mask_right,
        )
