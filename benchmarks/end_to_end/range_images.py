"""Range images instead of the second camera: the run of a stereo sequence, and of the same with ranges.

    python -m benchmarks.end_to_end.range_images [SEQ] [-o DIR] [--sigma-mm 3] [--frames N] [--ranges-only]

SEQ is a sequence that polhode simulate made; the sample by default. Its left images, calibration and truth
are taken over, ranges are measured in the place of the right images, and both are run with
configs/default.yaml and evaluated. Sequences and runs are kept in DIR, and what is there is not made again.
"""

import json
import shutil
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from benchmarks.command import DEFAULT, ROOT, command, polhode
from benchmarks.end_to_end.scenes import CONSISTENCY, HEAD, consistency_row, failed_row, row_of
from benchmarks.presentation import print_table
from polhode.config.scene_settings import RangeSensor, Scene
from polhode.dataset_writer import image_path, write_camera_csv, write_png, write_range_sensor
from polhode.range_images import RANGE_FOLDER
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import load_scene, plan_sequence


def main(
    sequence: Positional[Annotated[Path, arg(help="A simulated stereo sequence.")]] = ROOT / "sample",
    output: Annotated[Path, arg(aliases=["-o"], help="Folder of sequences and runs.")] = ROOT
    / "runs/range_images",
    sigma_mm: Annotated[float, arg(help="Noise of a range.")] = 3.0,
    frames: Annotated[int | None, arg(help="Use the first frames alone.")] = None,
    ranges_only: Annotated[bool, arg(help="Leave the stereo run out.")] = False,
) -> None:
    """Make what is missing and print both rows."""
    sensor, cases = RangeSensor(sigma_m=1e-3 * sigma_mm), []
    for name, ranges in (("stereo", None), ("ranges", sensor)):
        if ranges is None and ranges_only:
            continue
        data, run = output / f"{name}_sequence", output / f"{name}_run"
        if not data.is_dir():
            as_sequence(sequence, data, ranges, frames)
        if not (run / "summary.json").is_file():
            shutil.rmtree(run, ignore_errors=True)
            polhode("run", DEFAULT, "--data", data, "-o", run, may_fail=True)
        cases.append((name, run, data))
    results = [(name, *results_of(run, data)) for name, run, data in cases]
    for head, row in ((HEAD, row_of), (CONSISTENCY, consistency_row)):
        print()
        print_table(
            head,
            (
                failed_row(name, head, summary) if metrics is None else row(name, metrics, summary)
                for name, metrics, summary in results
            ),
        )


def results_of(run: Path, data: Path) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """metrics.json, None after a failure, and summary.json."""
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    if not (run / "trajectory.csv").is_file():
        return None, summary
    if not (run / "metrics.json").is_file():
        polhode("evaluate", run, data)
    return json.loads((run / "metrics.json").read_text(encoding="utf-8")), summary


def as_sequence(source: Path, folder: Path, sensor: RangeSensor | None, frames: int | None = None) -> None:
    """Copy a simulated stereo sequence, with ranges in the place of its right images if there is a sensor.

    ``frames``: the first ones alone.
    """
    scene, seed = load_scene(source / "scene.yaml")
    plan = plan_sequence(Scene.model_validate(scene.model_dump() | {"range_sensor": sensor}), seed)
    kept = plan.frames[:frames]
    stamps = plan.target.timestamps_ns[list(kept)]
    staged = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(staged, ignore_errors=True)
    for part in ("target0", "inspector0", "wrench0"):
        if (source / "mav0" / part).is_dir():
            shutil.copytree(source / "mav0" / part, staged / "mav0" / part)
    for index in range(len(plan.recording_cameras)):
        camera = staged / "mav0" / f"cam{index}"
        write_camera_csv(camera, stamps)
        shutil.copy(source / "mav0" / camera.name / "sensor.yaml", camera)
        (camera / "data").mkdir()
        for stamp in stamps:
            shutil.copy(image_path(source / "mav0" / camera.name, int(stamp)), camera / "data")
    if sensor is not None:
        write_range_sensor(
            staged / "mav0" / RANGE_FOLDER, sensor.scale_m, sensor.sigma_m, sensor.growth_per_m
        )
        write_camera_csv(staged / "mav0" / RANGE_FOLDER, stamps)
        renderer = FrameRenderer(plan)
        for k, stamp in zip(kept, stamps, strict=True):
            write_png(image_path(staged / "mav0" / RANGE_FOLDER, int(stamp)), renderer.render_range(k))
    staged.replace(folder)


if __name__ == "__main__":
    command(main)
