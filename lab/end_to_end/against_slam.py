"""A run beside COLMAP and ORB stereo odometry on the same images: poses, scale and points against the truth.

    python -m lab.end_to_end.against_slam [--scenes sample closed_tumble] [--record DIR]

``sample`` is that of the repository, where the target turns by 30 degrees from one pair to the next;
``closed_tumble`` is simulated from closed_tumble.yaml, with 14 degrees. To COLMAP and to the odometry the
target is the world, before which a camera moves: they get rectified images, masks of the target and the
calibration. Errors are those after one constant transform between each method's body frame and that of the
truth (found_poses.py), so that they differ from metrics.json, which fits no shift. "Not estimated" is what a
method has no unknown for. Processor seconds are those of all processes and threads, with the reading of the
images and, for polhode, with surface and report.

COLMAP needs pycolmap (``make fusion-peers``).
"""

import ctypes
import os
import resource
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Annotated, Any

from tyro.conf import arg

from lab.command import DEFAULT, RECORDS, ROOT, Record, Short, command, polhode, simulated
from lab.end_to_end.colmap import colmap_poses
from lab.end_to_end.found_poses import FoundPoses, pose_errors
from lab.end_to_end.orb_odometry import orb_odometry
from lab.mapping.mesh_quality import true_poses
from lab.presentation import Row, print_table
from lab.record import Case, complete, lines_of
from polhode.frontend.rectification import RectifiedPair, Rectifier, make_rectifier, rectified_pair
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import inverse_pose
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.read_truth import read_truth
from polhode.run_directory.stored_run import read_stored_run

RECORD = RECORDS / "against_slam"
HEAD = (
    "scene | method | poses | position [mm] | attitude: median, largest [deg] | scale [%] | points: number, "
    "median error [mm] | velocity, angular velocity, mass properties, sigmas | processor seconds"
)
Method = Callable[[Iterable[RectifiedPair], RectifiedRig], FoundPoses]
OTHERS: dict[str, Method] = {"COLMAP": colmap_poses, "ORB odometry": orb_odometry}
OURS = "polhode"
SHORT_FRAMES = 6
_PR_SET_CHILD_SUBREAPER = 36


def main(
    scenes: Annotated[tuple[str, ...], arg(help="Of sample, closed_tumble.")] = ("sample",),
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks and print the table."""
    methods = ("ORB odometry",) if short else (OURS, *OTHERS)
    cases: list[Case] = [{"scene": scene, "method": method} for scene in scenes for method in methods]
    if short:
        cases = [case | {"frames": SHORT_FRAMES} for case in cases]
    elif find_spec("pycolmap") is None:
        stored = {(line["case"]["scene"], line["case"]["method"]) for line in lines_of(record)}
        print("COLMAP is not installed here (make fusion-peers): its rows are those of the record\n")
        cases = [each for each in cases if each["method"] != "COLMAP" or tuple(each.values()) in stored]
    print_table(HEAD, map(row_of, complete(record, cases, measure, 1, process_each=True)))


def sequence_of(scene: str) -> Path:
    """The folder of a sequence with truth, simulated unless it is there."""
    if scene == "sample":
        return ROOT / "examples" / "sample"
    return simulated(Path(__file__).with_name(f"{scene}.yaml"), ROOT / "data" / scene)


def measure(case: Case) -> dict[str, Any]:
    """Errors of one method on one scene, its time, and why there is nothing where it fails."""
    folder = sequence_of(case["scene"])
    sequence, truth = open_sequence(folder), read_truth(folder)
    rectifier = make_rectifier(sequence.calibration)
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ true_poses(sequence, truth)
    if case["method"] == OURS:
        found, seconds = _own_poses(folder, sequence, rectifier)
    else:
        begin = process_time()
        pairs = (rectified_pair(sequence, rectifier, k) for k in range(case.get("frames", len(sequence))))
        found = OTHERS[case["method"]](pairs, rectifier.rig)
        seconds = process_time() - begin
    assert truth.mesh is not None
    errors = pose_errors(found, X_RG, truth.mesh)
    return {"of": len(sequence), "pieces": found.pieces, "processor_seconds": seconds, **vars(errors)}


def _own_poses(folder: Path, sequence: StereoSequence, rectifier: Rectifier) -> tuple[FoundPoses, float]:
    """Of ``polhode run`` with the default configuration, and the processor seconds of its processes."""
    with TemporaryDirectory() as scratch:
        run = Path(scratch) / "run"
        seconds = _processor_seconds(lambda: polhode("run", DEFAULT, "--data", folder, "-o", run))
        content = read_stored_run(run, "run")
    if content.motion is None or content.landmarks is None:
        raise ValueError("the run found no motion")
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ content.motion.X_NG
    frames = content.motion.trajectory.timestamps_ns.searchsorted(sequence.timestamps_ns)
    return FoundPoses(frames, X_RG, content.landmarks.p_G), seconds


def _processor_seconds(start: Callable[[], None]) -> float:
    """Of the processes that ``start`` starts and waits for, and of those that these leave behind (Linux)."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start()
    try:
        while True:
            os.wait()
    except ChildProcessError:
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def row_of(line: Case) -> Row:
    """One method on one scene."""
    case, ours = line["case"], line["case"]["method"] == OURS
    pieces = f" ({line['pieces']} pieces)" if line["pieces"] > 1 else ""
    return [
        case["scene"],
        case["method"],
        f"{line['frames']} of {line['of']}{pieces}",
        f"{line['rms_position_mm']:.3f}",
        f"{line['attitude_median_deg']:.3f}, {line['attitude_max_deg']:.3f}",
        f"{line['scale_error_percent']:+.3f}",
        f"{line['points']}, {line['point_median_mm']:.2f}",
        "estimated" if ours else "not estimated",
        f"{line['processor_seconds']:.0f}",
    ]


if __name__ == "__main__":
    command(main)
