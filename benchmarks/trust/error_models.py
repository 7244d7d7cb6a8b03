"""What the covariance has to know of correlated errors: models on the same measurements, by the truth.

    python -m benchmarks.trust.error_models [--groups configs new] [--names ...] [--table] [--short]

Each scene of the benchmark of trust is simulated, its images are measured once with configs/default.yaml, and
the motion is estimated from these measurements with each value of ``backend.correlated_errors``: errors
independent of one another; neighbours in an image alike; landmarks that drift besides; all of them sliding in
one direction besides, which is the default ("slide 0": by what is measured of the drift alone, without
``backend.light_px``). The solution is the same, its sigmas are not.

Prints the mean squared error over its expectation with the share within three sigma, pooled over the scenes,
then of each scene the largest of these ratios. A model holds where the pooled ratio is inside its band
(docs/trust.md).
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

from benchmarks.command import RECORDS, ROOT, Record, Short, Workers, command
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete, measured
from benchmarks.trust.cases import GROUPS, SHORT, scene_of
from benchmarks.trust.consistency import QUANTITIES, consistency_of, holds, pooled
from benchmarks.trust.judgement import SequenceTruth
from polhode.backend import estimate_motion, initialize_motion
from polhode.config import Config
from polhode.errors import RunFailure
from polhode.pipeline.context import open_context
from polhode.pipeline.correspondences import match_frames
from polhode.pipeline.evaluation import truth_of_frames
from polhode.pipeline.find_motion import find_motion
from polhode.pipeline.run_directory import outputs
from polhode.pipeline.run_directory.archives import read_measurements, read_relative_poses
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.trajectory_file import read_trajectory
from polhode.progress import Silent
from polhode.records import RelativePoses, StereoTracks
from polhode.simulation.dataset.sequence import plan_sequence, write_sequence

RECORD = RECORDS / "error_models"
MODELS: dict[str, dict[str, Any]] = {
    "none": {"correlated_errors": "none"},
    "neighbours": {"correlated_errors": "neighbours"},
    "drift": {"correlated_errors": "drift"},
    "slide 0": {"correlated_errors": "slide", "light_px": 0.0},
    "slide": {"correlated_errors": "slide"},
}
"""Values of ``backend``; the last one is the default."""


def main(
    groups: Annotated[tuple[Literal["configs", "new"], ...], arg(help="Groups of scenes.")] = (
        "configs",
        "new",
    ),
    names: Annotated[tuple[str, ...], arg(help="Only these of them.")] = (),
    draw: Annotated[int, arg(help="Which draw of the new scenes.")] = 1,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
    folder: Annotated[Path, arg(help="Where sequences and runs are kept.")] = ROOT / "runs/trust",
    keep: Annotated[bool, arg(help="Keep sequences and measurements, some 40 MB each.")] = False,
    table: Annotated[bool, arg(help="Only print the tables of what the record has.")] = False,
) -> None:
    """Measure what the record lacks, print the tables."""
    cases: list[Case] = [
        {"group": group, "name": name, **({"draw": draw} if group == "new" else {})}
        for group in groups
        for name in (SHORT if short else GROUPS)[group]
        if not names or name in names
    ]
    measure = Measure(folder, keep)
    print_tables(measured(record, cases) if table else complete(record, cases, measure, workers))


@dataclass(frozen=True)
class Measure:
    """One scene by all models."""

    folder: Path
    keep: bool

    def __call__(self, case: Case) -> Case:
        """The row of a case; a sequence or run that an interrupted one left is used."""
        group, name, draw = case["group"], case["name"], case.get("draw", 1)
        place = self.folder / group / (f"{name}_{draw}" if group == "new" else name)
        sequence = place / "sequence"
        if not (sequence / "mav0").is_dir():
            scene, seed = scene_of(group, name, draw, self.folder / "meshes")
            write_sequence(plan_sequence(scene, seed), sequence, Silent())
        try:
            tracks, links = measurements(place)
            return {"models": {model: judged_model(model, tracks, links, place) for model in MODELS}}
        except RunFailure as failure:
            return {"failure": str(failure), "models": {}}
        finally:
            if not self.keep:
                shutil.rmtree(place)


def measurements(place: Path) -> tuple[StereoTracks, RelativePoses]:
    """Of a run that is there, or of the images: what the last solution is made from. Raises RunFailure."""
    made = place / "measured"
    for run in (place / "run", made):
        if (run / "measurements.npz").is_file():
            links = read_relative_poses(run)
            if links is not None:
                return read_measurements(run), links
    context = open_context(place / "sequence", Config.model_validate({"runtime": {"workers": 1}}), Silent())
    solution = find_motion(context, match_frames(context))
    made.mkdir(exist_ok=True)
    outputs.write_estimate(made, solution.tracks, solution.estimate, solution.links)
    return solution.tracks, solution.links


def judged_model(model: str, tracks: StereoTracks, links: RelativePoses, place: Path) -> dict[str, Any]:
    """Consistency of the estimate with one model; its files are kept beside the measurements."""
    config = Config.model_validate({"backend": MODELS[model]})
    initial = initialize_motion(tracks, links, config.backend)
    estimate = estimate_motion(tracks, initial, config.backend, Silent())
    out = place / f"errors_{model.replace(' ', '_')}"
    out.mkdir(exist_ok=True)
    outputs.write_config(out, config)
    outputs.write_estimate(out, tracks, estimate, links)
    stamps_ns = read_trajectory(out).timestamps_ns
    truth = truth_of_frames(place / "sequence", stamps_ns)
    assert truth is not None
    return consistency_of(out, read_summary(out), SequenceTruth(stamps_ns, truth))


def print_tables(lines: Sequence[Case]) -> None:
    """Pooled by model, then of each scene the largest ratio by model."""
    failed = [line["case"]["name"] for line in lines if "failure" in line]
    found = [line for line in lines if line["models"]]
    if failed:
        print(f"No motion is found: {', '.join(failed)}\n")
    if not found:
        return
    print(
        f"{len(found)} scenes, by model: mean squared error over its expectation (within three sigma [%])\n"
    )
    rows = [[model, *(_pooled_cell(found, model, quantity) for quantity in QUANTITIES)] for model in MODELS]
    print_table(("model", *QUANTITIES), rows, right_from=1)
    print("\nThe largest ratio of each scene, and of which quantity\n")
    rows = [[_name(line), *(_worst(line["models"][model]) for model in MODELS)] for line in found]
    print_table(("scene", *MODELS), rows, right_from=1)


def _name(line: Case) -> str:
    case = line["case"]
    return f"{case['name']} {case['draw']}" if "draw" in case else str(case["name"])


def _pooled_cell(lines: Sequence[Case], model: str, quantity: str) -> str:
    """Ratio, its band, coverage; in bold where they do not hold."""
    entries = [line["models"][model][quantity] for line in lines if quantity in line["models"][model]]
    result = pooled(entries)
    if result["ratio"] is None:
        return "-"
    text = f"{result['ratio']:.2f} to {result['high']:.2f} ({100.0 * result['coverage']:.1f})"
    return text if holds(result) else f"**{text}**"


def _worst(entries: dict[str, Any]) -> str:
    if not entries:
        return "-"
    name = max(entries, key=lambda each: entries[each]["nees"] / entries[each]["expected"])
    return f"{entries[name]['nees'] / entries[name]['expected']:.2f} {name}"


if __name__ == "__main__":
    command(main)
