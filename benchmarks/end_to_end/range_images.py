"""Range images instead of a second camera: the replica of Test Session 38, with errors beside their sigmas.

    python -m benchmarks.end_to_end.range_images [-o DIR] [--sigma-mm 3 ...] [--frames N] [--record FILE]

configs/scenes/range_ts38.yaml is simulated, once for each noise of a range with the same images, run with
configs/default.yaml and evaluated. Sequences and runs are kept in DIR, and what is there is not made again.

Beside each error is its standard deviation by the covariance of the run, the root mean square over the
frames: what an estimator without bias can reach with measurements of this noise (the bound of Cramer and
Rao, at the estimate).
"""

import json
import shutil
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import DEFAULT, RECORDS, ROOT, Record, command, polhode
from benchmarks.end_to_end.scenes import percent, ratio, share
from benchmarks.presentation import Row, print_table
from benchmarks.record import Case, complete
from polhode.config.scene_settings import RangeSensor, Scene
from polhode.dataset_writer import image_path, write_camera_csv, write_png, write_range_sensor
from polhode.range_images import RANGE_FOLDER
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import load_scene, plan_sequence

SCENE = ROOT / "configs/scenes/range_ts38.yaml"
RECORD = RECORDS / "range_images"
ERRORS = (
    "noise | position [mm] (sigma) | velocity [mm/s] (sigma) | w [deg/s] (sigma) | attitude [deg] (sigma) | "
    "error k1 (sigma) | error k2 (sigma) | com [mm] (sigma) | chamfer [mm] (within 3 mm) | frames | seconds"
)
CONSISTENCY = "noise | NEES r | v | attitude | w | inertia | com | within 3 sigma: r [%] | v | attitude | w"
COMPONENTS = {"position": 3, "velocity": 3, "attitude": 3, "angular_velocity": 3, "inertia": 5, "com": 3}


def main(
    output: Annotated[Path, arg(aliases=["-o"], help="Folder of sequences and runs.")] = ROOT
    / "runs/range_images",
    sigma_mm: Annotated[tuple[float, ...], arg(help="Noise of a range.")] = (3.0,),
    frames: Annotated[int, arg(help="So many of the 115 frames.")] = 115,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print both tables."""
    cases: list[Case] = [{"sigma_mm": sigma, "frames": frames} for sigma in sigma_mm]
    lines = complete(record, cases, Measurement(output), workers=1)
    for head, row in ((ERRORS, errors_row), (CONSISTENCY, consistency_row)):
        print()
        print_table(head, map(row, lines))


class Measurement:
    """Simulate, run and evaluate a case, below a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self, case: Case) -> dict[str, Any]:
        """Errors, their sigmas, and what the run says of itself."""
        noise, frames = f"{case['sigma_mm']:g}mm", case["frames"]
        images = self.folder / f"images_{frames}"
        if not images.is_dir():
            polhode("simulate", SCENE, "-o", images, "--scene.frames", frames)
        data, run = self.folder / f"sequence_{noise}_{frames}", self.folder / f"run_{noise}_{frames}"
        if not data.is_dir():
            as_sequence(images, data, RangeSensor(sigma_m=1e-3 * case["sigma_mm"]))
        if not (run / "summary.json").is_file():
            shutil.rmtree(run, ignore_errors=True)
            polhode("run", DEFAULT, "--data", data, "-o", run, may_fail=True)
        summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
        if not (run / "trajectory.csv").is_file():
            return {"status": summary["status"], "reason": summary["warnings"][0]}
        if not (run / "metrics.json").is_file():
            polhode("evaluate", run, data)
        metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
        kept = ("status", "frames", "frames_used", "landmarks", "observations", "identifiable")
        return {
            **{key: summary[key] for key in kept},
            "seconds": summary["timing_s"]["total"],
            "sigma": _sigmas(run, summary),
            **{key: metrics[key] for key in metrics if key not in ("half_turn", "summary_sha256")},
        }


def _sigmas(run: Path, summary: dict[str, Any]) -> dict[str, float | None]:
    """Root mean square of the standard deviations over the frames, of vectors by their length."""
    with np.load(run / "covariance.npz") as stored:
        variance = np.diagonal(stored["covariance"], axis1=1, axis2=2).mean(axis=0)
        names = [str(name) for name in stored["order"]]
        turn = np.diagonal(stored["covariance_X_NG"], axis1=1, axis2=2).mean(axis=0)[3:]

    def length(of: str) -> float:
        return float(np.sqrt(sum(variance[n] for n, name in enumerate(names) if name.startswith(of))))

    of_k = [summary["inertia"]["cov"][n][n] for n in (0, 1)]
    com = summary["cov_com_G"]
    return {
        "position_m": length("r_N"),
        "velocity_m_s": length("v_N"),
        "angular_velocity_deg_s": float(np.rad2deg(length("w_P"))),
        "attitude_deg": float(np.rad2deg(np.sqrt(turn.sum()))),
        "com_mm": None if com is None else 1e3 * float(np.sqrt(np.trace(com))),
        **{f"k{n + 1}": None if each is None else float(np.sqrt(each)) for n, each in enumerate(of_k)},
    }


def errors_row(line: Case) -> Row:
    """Errors and their sigmas."""
    noise = f"{line['case']['sigma_mm']:g} mm"
    if "sigma" not in line:
        return [noise, f"failed: {line['reason']}", *[""] * (ERRORS.count("|") - 1)]
    sigma, mesh, known = line["sigma"], line["mesh"], line["identifiable"]

    def beside(error: float, name: str, form: str, scale: float = 1.0) -> str:
        of = sigma[name]
        return f"{scale * error:{form}} ({'unbounded' if of is None else format(scale * of, form)})"

    return [
        noise if line["status"] == "ok" else f"{noise} ({line['status']})",
        beside(line["rmse_position_m"], "position_m", ".3f", 1e3),
        beside(line["rmse_velocity_m_s"], "velocity_m_s", ".3f", 1e3),
        beside(line["rmse_angular_velocity_deg_s"], "angular_velocity_deg_s", ".4f"),
        beside(line["attitude_error_deg"]["median"], "attitude_deg", ".4f"),
        *(
            ratio(
                line[f"error_k{n}"], None if sigma[f"k{n}"] is None else sigma[f"k{n}"] ** 2, known[f"k{n}"]
            )
            for n in (1, 2)
        ),
        beside(line["error_com_mm"], "com_mm", ".3f") if known["com"] else "not determined",
        f"{mesh['chamfer_mm']:.2f} ({mesh['completeness_3mm']:.3f})",
        f"{line['frames_used']} of {line['frames']}",
        f"{line['seconds']:.0f}",
    ]


def consistency_row(line: Case) -> Row:
    """Whether the sigmas hold."""
    noise = f"{line['case']['sigma_mm']:g} mm"
    if "sigma" not in line:
        return [noise, *["-"] * CONSISTENCY.count("|")]
    nees, within = line["nees"], line["coverage_3sigma"]
    return [
        noise,
        *(share(nees[key], components) for key, components in COMPONENTS.items()),
        *(percent(within[key]) for key in ("position", "velocity", "attitude", "angular_velocity")),
    ]


def as_sequence(source: Path, folder: Path, sensor: RangeSensor) -> None:
    """Copy the left images of a simulated sequence, with ranges of this sensor in the place of all else."""
    scene, seed = load_scene(source / "scene.yaml")
    plan = plan_sequence(
        Scene.model_validate(
            scene.model_dump() | {"range_sensor": sensor.model_copy(update={"enabled": True})}
        ),
        seed,
    )
    stamps = plan.target.timestamps_ns[list(plan.frames)]
    staged = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(staged, ignore_errors=True)
    for part in ("cam0", "target0", "inspector0", "wrench0"):
        if (source / "mav0" / part).is_dir():
            shutil.copytree(source / "mav0" / part, staged / "mav0" / part)
    ranges = staged / "mav0" / RANGE_FOLDER
    write_range_sensor(ranges, sensor.scale_m, sensor.sigma_m, sensor.growth_per_m)
    write_camera_csv(ranges, stamps)
    renderer = FrameRenderer(plan)
    for k, stamp in zip(plan.frames, stamps, strict=True):
        write_png(image_path(ranges, int(stamp)), renderer.render_range(k))
    staged.replace(folder)


if __name__ == "__main__":
    command(main)
