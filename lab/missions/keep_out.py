"""Keep-out volumes of the missions, judged by their truth: is the whole true body inside, and at what size?

    python -m lab.missions.keep_out [--first 0] [--last 320] [--ambiguous] [--workers 1] [--table] [--short]

Each mission is simulated and run as by ``lab.missions.missions``, whose sequences and runs are used again;
its volume at 99 % is a row of the record, and an interrupted benchmark goes on. Points of the true body's
outer surface move along the true motion after the last pair; those that no frame saw in light count apart.
The volume is compared with what the true body sweeps under the run's own covariance (``smallest_sweep``), and
clearances at random places with the true ones. ``--ambiguous``: missions that turn by more than half a
revolution between pairs at equal intervals, of which a revolution is stated as the limit; those count whose
run has several hypotheses of the rotation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation
from tyro.conf import arg

from lab.command import RECORDS, ROOT, Record, Short, Workers, command
from lab.missions.draw import MISSIONS, TUNED_DRAW, Mission, mission
from lab.missions.keep_out_judgement import keep_out_judgement
from lab.missions.missions import sequence_and_run
from lab.presentation import print_table
from lab.record import Case, complete, measured
from lab.registry import SAMPLE_RUN
from lab.short_forms import make_sample_run
from polhode.planning.keep_out.volumes import KeepOutOptions
from polhode.run_directory.summary import read_summary
from polhode.simulation.dataset.sequence import plan_sequence

CONFIDENCE = 0.99
TURN_DEG = (230.0, 330.0)
"""Between two pairs of an ambiguous mission"""
OFF_SIGHT, NUTATION = 0.1, 0.02
"""How far its principal axis is from the line of sight, and the spin from that axis [rad]"""
LARGE = 2.5
"""A ratio of the volumes above which a mission has a row of its own"""
KINDS = ("family", "light")
OUTSIDE = (
    "mission | kinds | hypotheses | seen part outside [mm] | of the size [%] | seen part at instants [mm] | "
    "unseen part outside [mm] | ratio | clearances too large | from the run's mesh [mm]"
)
SUMMARY = (
    "missions | number | volumes | whole inside | seen part inside | unseen part inside | "
    "whole inside at instants | seen part at instants | watertight | ratio, median | largest | seconds"
)


def main(
    first: Annotated[int, arg(help="Number of the first mission.")] = 0,
    last: Annotated[int, arg(help="The one before which to stop.")] = MISSIONS,
    draw: Annotated[int, arg(help="Draw; others than the first have not been looked at.")] = TUNED_DRAW,
    horizon: Annotated[float, arg(help="Seconds ahead.")] = 60.0,
    ambiguous: Annotated[bool, arg(help="Missions whose rotation several hypotheses explain.")] = False,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORDS / "keep_out",
    folder: Annotated[Path, arg(help="Where sequences and runs are kept.")] = ROOT / "runs/missions",
    table: Annotated[bool, arg(help="Only print the tables of what the record has.")] = False,
) -> None:
    """Measure what the record lacks, print the tables."""
    numbers, horizon = (range(1), 2.0) if short else (range(first, last), horizon)
    cases = [_case(n, draw, horizon, ambiguous) for n in numbers]
    measure = measure_sample if short else Measure(folder)
    lines = measured(record, cases) if table else complete(record, cases, measure, workers)
    if ambiguous:
        lines = [line for line in lines if line.get("hypotheses", 1) > 1]
    print_kinds(lines)
    print_single(lines)
    print_totals(lines)


def _case(number: int, draw: int, horizon_s: float, ambiguous: bool) -> Case:
    kinds = mission(number, draw).kinds
    return {"number": number, "draw": draw, "horizon_s": horizon_s, "ambiguous": ambiguous, **kinds}


@dataclass(frozen=True)
class Measure:
    """The volume of one mission, judged."""

    folder: Path

    def __call__(self, case: Case) -> Case:
        """The row of a case."""
        number, draw = case["number"], case["draw"]
        flown = ambiguous_mission(number, draw) if case["ambiguous"] else mission(number, draw)
        place = self.folder / f"{draw}{'_ambiguous' if case['ambiguous'] else ''}" / f"{number:03d}"
        stated = {"backend.max_rpm": 60.0 / flown.scene.interval_s} if case["ambiguous"] else None
        sequence, run = sequence_and_run(flown, place, stated)
        if case["ambiguous"] and len(read_summary(run).hypotheses) < 2:
            return {"none": "its rotation is not ambiguous"}
        options = KeepOutOptions(case["horizon_s"], CONFIDENCE)
        return keep_out_judgement(run, sequence, options, number)


def measure_sample(case: Case) -> Case:
    """The row of the sample's run, for the short form; made unless it is there."""
    make_sample_run()
    options = KeepOutOptions(case["horizon_s"], CONFIDENCE, members=60, cells=24)
    return keep_out_judgement(ROOT / SAMPLE_RUN, ROOT / "examples/sample", options, 0)


def ambiguous_mission(number: int, draw: int) -> Mission:
    """A mission with so fast a rotation about the line of sight that pairs leave its rate open.

    The axis of the greatest moment points along it, so that the same side stays in view.
    """
    flown = mission(number, draw)
    rng = np.random.default_rng([draw, number, 0xA3B])
    scene, motion = flown.scene, flown.scene.motion
    axes = plan_sequence(scene, flown.seed).mass.R_GP
    sight_N = np.array([0.0, 0.0, rng.choice([-1.0, 1.0])]) + OFF_SIGHT * rng.normal(size=3)
    R_NG = Rotation.from_rotvec(np.deg2rad(motion.attitude_deg))
    onto_sight, _ = Rotation.align_vectors(sight_N[None], R_NG.apply(axes[:, 0])[None])
    rpm = rng.uniform(*TURN_DEG) / 6.0 / scene.interval_s
    turning = motion.model_copy(
        update={
            "attitude_deg": tuple(np.rad2deg((onto_sight * R_NG).as_rotvec()).tolist()),
            "spin_rpm": tuple((rpm * np.array([1.0, *NUTATION * rng.normal(size=2)])).tolist()),
            "spin_axes": "principal",
        }
    )
    return replace(flown, motion="ambiguous", scene=scene.model_copy(update={"motion": turning}))


def print_kinds(lines: Sequence[Case]) -> None:
    """A row for each family and light, and for all."""
    rows = [
        [f"{kind} {value}", *summary([line for line in lines if line["case"][kind] == value])]
        for kind in KINDS
        for value in dict.fromkeys(line["case"][kind] for line in lines)
    ]
    print_table(SUMMARY, [*rows, ["all", *summary(lines)]], right_from=1)


def summary(lines: Sequence[Case]) -> list[object]:
    """Cells of the missions of a kind, without its name."""
    found = [line for line in lines if "none" not in line]
    counts = (
        sum(all(is_inside(line, volume, part) for part in parts) for line in found)
        for volume, parts in (
            ("swept", ("seen", "unseen")), ("swept", ("seen",)), ("swept", ("unseen",)),
            ("instant", ("seen", "unseen")), ("instant", ("seen",)),
        )
    )  # fmt: skip
    cells: list[object] = [len(lines), len(found), *counts, sum(line["watertight"] for line in found)]
    if not found:
        return [*cells, "-", "-", "-"]
    ratios, seconds = ([line[key] for line in found] for key in ("ratio", "seconds_cpu"))
    return [*cells, f"{np.median(ratios):.2f}", f"{max(ratios):.2f}", f"{np.median(seconds):.1f}"]


def is_inside(line: Case, volume: str, part: str) -> bool:
    """Whether all points of a part, "seen" or "unseen", stay inside a volume, "swept" or "instant"."""
    return bool((line[volume][part]["farthest_m"] or 0.0) <= 0.0)


def print_single(lines: Sequence[Case]) -> None:
    """A row for each mission whose seen part comes out of a volume, or whose volume is large; the last column
    is the least distance from the run's mesh of what comes out at an instant: a part that the mesh lacks?
    """
    chosen = [
        line
        for line in lines
        if "none" not in line
        and (line["ratio"] > LARGE or not all(is_inside(line, each, "seen") for each in ("swept", "instant")))
    ]
    print()
    print_table(OUTSIDE, map(_single, chosen), right_from=2)


def _single(line: Case) -> list[object]:
    case, swept, least_m = line["case"], line["swept"], line["least_from_mesh_m"]
    return [
        case["number"],
        ", ".join(case[kind] for kind in ("family", "motion", "light", "rig", "inspector")),
        line["hypotheses"],
        _millimetres(swept["seen"]["farthest_m"]),
        f"{100.0 * (swept['seen']['farthest_share'] or 0.0):.2f}",
        _millimetres(line["instant"]["seen"]["farthest_m"]),
        _millimetres(swept["unseen"]["farthest_m"]),
        f"{line['ratio']:.2f}",
        line["claims"]["wrong"],
        _millimetres(least_m),
    ]


def _millimetres(value_m: float | None) -> str:
    return "-" if value_m is None else f"{1e3 * value_m:.1f}"


def print_totals(lines: Sequence[Case]) -> None:
    """How often the promise holds in all, what the claimed clearances are worth, why volumes are missing."""
    found = [line for line in lines if "none" not in line]
    if found:
        seen, unseen = (sum(line["swept"][part]["points"] for line in found) for part in ("seen", "unseen"))
        print(f"\nPoints of outer surfaces: {seen} seen in light, {unseen} not")
        clear, wrong, unseen = (
            sum(line["claims"][key] for line in found) for key in ("clear", "wrong", "wrong_of_unseen")
        )
        most_m = max(line["claims"]["most_over_m"] for line in found)
        print(
            f"Claimed clearances: {clear}; too large {wrong}, and {unseen} by parts that were not seen, by "
            f"{1e3 * most_m:.2f} mm at most"
        )
        seconds, sift = (np.array([line[key] for line in found]) for key in ("seconds_cpu", "sift_cpu"))
        print(f"Seconds of the processor: median {np.median(seconds):.1f}, most {max(seconds):.1f}")
        print(f"Over those of one SIFT on the target in all images: median {np.median(seconds / sift):.2f}")
        of_union = ("ratio_to_union", "leaving_union")
        ratio, leaving = (np.median([line[key] for line in found]) for key in of_union)
        print(f"Over the members' union, which {leaving:.1%} of further members leave: {ratio:.2f} (medians)")
    for line in lines:
        if "none" in line:
            print(f"Mission {line['case']['number']} has no volume: {line['none']}")


if __name__ == "__main__":
    command(main)
