"""The commands that write, made quick: they write as always, but the work is done once or left out."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import polhode.calibration.calibrate
import polhode.cli.main
import polhode.compare.comparison
import polhode.pipeline.checkout.checkout
import polhode.pipeline.run
import polhode.planning.observability.assess
import polhode.planning.observability.files
import polhode.planning.observability.pictures
import polhode.planning.plan
import polhode.planning.plan_files
import polhode.studies.sweep
import polhode.train.run
import polhode.viewer.show_run
from polhode.calibration.adjustment import adjust
from polhode.calibration.boards import make_board
from polhode.calibration.calibrate import CalibratedRig, Views
from polhode.calibration.detection import Found
from polhode.calibration.image_pairs import ImagePairs
from polhode.config import Config
from polhode.files.atomic import write_text
from polhode.pipeline.checkout.checkout import Checkout
from polhode.pipeline.checkout.result import CheckoutResult
from polhode.pipeline.run import RunResult
from polhode.planning.keep_out.volumes import KeepOutOptions
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_sensor
from polhode.report import write_report
from polhode.run_directory.run_folder import atomic_run_folder
from polhode.run_directory.stored_run import StoredMotion
from polhode.studies.steps import failed_record
from polhode.studies.store import Store
from polhode.studies.study import OpenStudy
from polhode.viewer.recorder import Recorder
from tests.calibration.synthetic_rigs import SIZE, rig, seen_corners
from tests.pipeline.conftest import Example, write_example

SCENE = """
seed: 4
scene:
  frames: 1
  truth_horizon_s: 0
  rig: {width_px: 48, height_px: 36, focal_px: 35.0}
  motion: {position_m: [0.04, 0.0, 0.6]}
  light: {earth: 0.0}
  render: {samples: 1, bounces: 0}
runtime: {workers: 1}
"""
LONG = "0123456789\n" * 1000
"""More than the few bytes that a nearly full place still takes."""


@dataclass(frozen=True)
class Writer:
    """A command that writes, and what it writes."""

    command: str
    target: str
    """A name of what -o names"""
    main_file: str
    """In the folder, or "" for the file itself: it tells that the command has written"""
    arguments: str
    """RUN, MAV0 and INPUTS stand for places of the stage"""
    option: str = "-o"
    overwrite: bool = False
    """Whether it has --overwrite"""
    beside: str = ""
    """A folder that it writes beside the file"""

    @property
    def is_folder(self) -> bool:
        """Whether -o names a folder."""
        return self.main_file != ""


WRITERS: Mapping[str, Writer] = {
    "run": Writer("run", "R", "summary.json", "--data INPUTS/none", overwrite=True),
    "simulate": Writer("simulate", "S", "scene.yaml", "INPUTS/scene.yaml", overwrite=True),
    "import": Writer("import", "I", "import.json", "INPUTS/recording", overwrite=True),
    "compare": Writer("compare", "C", "compare.json", "--run RUN"),
    "sweep": Writer("sweep", "W", "table.parquet", "INPUTS/study.yaml"),
    "train": Writer("train", "T", "scores.json", "INPUTS/train.yaml"),
    "calibrate": Writer(
        *("calibrate", "B", "calibration.json"),
        "--left MAV0/cam0/data --right MAV0/cam1/data --board 9x6 --square-mm 30",
    ),
    "checkout": Writer("checkout", "K", "checkout.json", "INPUTS/none"),
    "plan": Writer("plan", "P", "planning.json", "RUN"),
    "observability": Writer("observability", "O", "observability.json", "RUN"),
    "export": Writer("export", "target.stl", "", "RUN --to stl"),
    "export urdf": Writer("export", "u.urdf", "", "RUN --to urdf --pieces 1", beside="u.urdf_meshes"),
    "predict": Writer("predict", "ahead.csv", "", "RUN --horizon 30"),
    "report": Writer("report", "page.html", "", "RUN"),
    "view": Writer("view", "shown.rrd", "", "RUN", option="--save"),
}


@dataclass(frozen=True)
class Stage:
    """The inputs of all commands, in a folder that none of them may change."""

    inputs: Path
    run: Path

    def words(self, name: str, output: Path, *more: str) -> list[str]:
        """The command line of a writer."""
        writer = WRITERS[name]
        places = {"RUN": self.run, "MAV0": self.inputs / "recording" / "mav0", "INPUTS": self.inputs}
        arguments = []
        for word in writer.arguments.split():
            place, *rest = word.split("/")
            arguments.append(str(places[place].joinpath(*rest)) if place in places else word)
        return [writer.command, *arguments, writer.option, str(output), *more]

    def call(self, name: str, output: Path, *more: str) -> int:
        """Run a writer as the user does."""
        return polhode.cli.main.main(self.words(name, output, *more))


def make_stage(folder: Path, example: Example) -> Stage:
    """A stored run, a scene and a training."""
    folder.mkdir()
    (folder / "scene.yaml").write_text(SCENE)
    _write_recording(folder / "recording")
    (folder / "study.yaml").write_text("axes: {seed: [1, 2]}\nsteps: []\n")
    (folder / "train.yaml").write_text(f"train: {{corpus: {{folder: {folder / 'corpus'}}}}}\n")
    run = folder / "stored"
    run.mkdir()
    write_example(run, example)
    # the library of its figures is most of a page
    (run / "report.html").write_text("<html><title>stored · polhode</title>")
    return Stage(folder, run)


def _write_recording(folder: Path) -> None:
    """Three pairs, each image larger than what a nearly full place still takes."""
    rng = np.random.default_rng(1)
    for index in (0, 1):
        camera, X_BC = folder / "mav0" / f"cam{index}", np.eye(4)
        X_BC[0, 3] = 0.1 * index
        K = np.array([[90.0, 0.0, 47.5], [0.0, 90.0, 47.5], [0.0, 0.0, 1.0]])
        write_sensor(camera, K, np.zeros(4), X_BC, (96, 96), rate_hz=1.0)
        stamps = [k * 10**9 for k in range(3)]
        write_camera_csv(camera, stamps)
        for stamp in stamps:
            write_png(image_path(camera, stamp), rng.integers(0, 256, (96, 96), dtype=np.uint8))


def make_quick(patch: pytest.MonkeyPatch, stage: Stage) -> None:
    """Replace the work by its stored results; what checks, writes and replaces is the program's own."""
    patch.setattr(polhode.pipeline.run, "run", partial(run_of_stored_files, stage.run))
    patch.setattr(polhode.compare.comparison, "_compared", _compared)
    patch.setattr("polhode.compare.tables.format_tables", lambda comparison: "")
    patch.setattr(
        polhode.studies.sweep, "opened_cluster", lambda *_: nullcontext(SimpleNamespace(description=""))
    )
    patch.setattr(polhode.studies.sweep, "_Window", _RecordsWithoutWork)
    patch.setattr(polhode.train.run, "_trained", _trained)
    patch.setattr(polhode.pipeline.checkout.checkout, "checkout", lambda *_: _checked())
    patch.setattr(polhode.calibration.calibrate, "calibrate", lambda pairs, *_: _calibrated(pairs))
    patch.setattr(polhode.train.run, "require_same_training", lambda *_: None)
    patch.setattr(polhode.viewer.show_run, "show_stored_run", _one_path)
    once = _Once()
    plan, assess = polhode.planning.plan, polhode.planning.observability.assess
    few = KeepOutOptions(2.0, 0.97, members=100, cells=24)
    plan_run, real_assess, subject_of = plan.plan_run, assess.assess, assess.subject_of
    patch.setattr(plan, "plan_run", lambda run, *_: once("plan", lambda: plan_run(run, few, None)))
    patch.setattr(polhode.planning.plan_files, "draw_keepout", lambda *_: b"png")
    patch.setattr(assess, "subject_of", lambda *words: once("subject", lambda: subject_of(*words)))
    patch.setattr(assess, "assess", lambda *words: once("assessment", lambda: real_assess(*words)))
    for name in ("draw_metric", "draw_contributions"):
        patch.setattr(polhode.planning.observability.pictures, name, lambda *_: b"png")


def run_of_stored_files(
    stored: Path,
    config: Config,
    data: Path,
    folder: Path,
    progress: object,
    overwrite: bool = False,
    even_if_failed: bool = False,
    resume: bool = False,
    work: Callable[[Path], None] = lambda folder: None,
) -> RunResult:
    """A run whose files are those of another one; ``work`` comes after they are written."""
    del config, data, progress
    with atomic_run_folder(folder, overwrite, write_report, even_if_failed, resume) as written:
        for path in sorted(stored.iterdir()):
            write_text(written.path / path.name, "") if path.name == "log.txt" else shutil.copy(
                path, written.path
            )
        work(written.path)
    return RunResult("ok", written.published / "report.html", "done:", None, written.note)


class _Once:
    """Keeps the first result for each name, over all tests of the process."""

    known: dict[str, Any] = {}  # noqa: RUF012

    def __call__(self, name: str, make: Callable[[], Any]) -> Any:
        if name not in self.known:
            self.known[name] = make()
        return self.known[name]


def _one_path(
    run: object, motion: StoredMotion, tracks: object, pictures: object, recorder: Recorder, progress: object
) -> None:
    """A recording of one path instead of all frames."""
    del run, tracks, pictures, progress
    recorder.log_polhode_path(motion.trajectory.w_P)


def _compared(config: Config, folder: Path, *_: object) -> Any:
    del config
    for name in polhode.compare.comparison.FILES:
        write_text(folder / name, LONG)
    return SimpleNamespace(rows=[SimpleNamespace(status="ok", model_dump=lambda **_: {})])


class _RecordsWithoutWork:
    """Stores a record of each point."""

    def __init__(self, study: OpenStudy, store: Store, cluster: object, missing: Sequence[int]) -> None:
        del cluster
        self._points, self._store = [study.point(number) for number in missing], store

    def outcomes(self) -> Iterator[str]:
        """Of each point."""
        for point in self._points:
            self._store.write(failed_record(point.address, point.values, "") | {"status": "done"})
            yield "done"


def _calibrated(pairs: ImagePairs) -> CalibratedRig:
    """A rig by corners that were drawn, without images."""
    rng = np.random.default_rng(0)
    truth = rig("brown5", len(pairs.names[0]), rng)
    data = seen_corners(truth, 0.1, rng)
    adjusted = adjust(data, truth, np.ones(truth.shared, dtype=np.bool_), robust=False)
    views = Views(make_board("chessboard", "9x6", 0.03), pairs)
    for camera, seen in enumerate(data):
        for pair in np.unique(seen.view).tolist():
            uv = seen.uv_px[seen.view == pair]
            views.found[camera][pair] = Found(np.arange(len(uv)), uv)
            views.sizes_px[camera][pair] = SIZE
    return CalibratedRig(views, adjusted, (data[0], data[1]), (0.1, 0.1), 0)


def _checked() -> Checkout:
    result = CheckoutResult(status="PASS", pairs=0, pairs_examined=0, rig="sequence", checks=())
    return Checkout(result, None)


def _trained(config: Config, train: object, output: Path, *_: object) -> Any:
    del config, train
    for name in (*polhode.train.run.FILES, "descriptor.safetensors"):
        write_text(output / name, LONG)
    outcome = SimpleNamespace(scores={}, finished=True)
    return polhode.train.run.Trained(output / "descriptor.safetensors", outcome)  # type: ignore[arg-type]
