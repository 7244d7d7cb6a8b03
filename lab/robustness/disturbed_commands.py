"""The commands that are killed, or whose disk is full, and what each makes when nothing disturbs it.

In the words, {stage} is the folder of the inputs, {place} that of the case.
"""

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lab.command import ROOT
from lab.robustness.results import State, contents, is_failed_run, judged, names_of
from lab.robustness.small_data import SCENE, write_boards
from polhode.cli.main import main

Words = tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """One command line."""

    name: str
    words: Words
    results: tuple[str, ...]
    """Names in the folder of the case that the command makes"""
    before: Words = ()
    """Makes an earlier good result, of other settings"""
    inputs: tuple[str, ...] = ()
    """Names of the stage that are copied into the folder of the case first"""
    later: tuple[Words, ...] = ()
    """Commands that read the result"""
    overwrite: bool = False
    """Whether the command is repeated with --overwrite: it refuses a result that is there"""
    continues: tuple[str, ...] = ()
    """Hidden folders beside the result in which the same command goes on"""
    resumes: bool = False
    """Whether an unfinished result may be visible; the same command goes on with it, or begins again"""

    def reads(self, name: str) -> bool:
        """Whether the command, or one before or after it, needs this input of the stage."""
        every = (*self.words, *self.before, *(word for words in self.later for word in words))
        place = f"{{stage}}/{name}"
        return name in self.inputs or any(word == place or word.startswith(f"{place}/") for word in every)

    @property
    def repeated(self) -> Words:
        """The words that repeat the command, whatever is there."""
        return (*self.words, "--overwrite") if self.overwrite else self.words


_RUN = ("run", "--data", "{stage}/S", "-o", "{place}/R", "--runtime.workers", "2")
_SIMULATE = ("simulate", "{stage}/scene.yaml", "-o", "{place}/S")
_TRAIN = (
    *("train", "{stage}/train.yaml", "--train.output", "{place}/T"),
    *("--train.corpus.folder", "{place}/corpus"),
)
_PLAN = ("plan", "{stage}/R", "-o", "{place}/P", "--horizon", "10")
_READERS = (("predict", "{place}/R", "--horizon", "5"), ("report", "{place}/R", "-o", "{stage}/later.html"))
_CALIBRATE = (
    *("calibrate", "--left", "{stage}/boards/left", "--right", "{stage}/boards/right"),
    *("--board", "7x5", "--square-mm", "30", "-o", "{place}/B"),
)
_CHECKOUT = ("checkout", "{stage}/S", "-o", "{place}/C")
_IMPORT = ("import", "{stage}/S", "-o", "{place}/I")
_CHECKED = (("checkout", "{place}/I", "-o", "{place}_later"),)

JOBS = {
    job.name: job
    for job in (
        Job("run", _RUN, ("R",), later=_READERS, overwrite=True),
        Job("run --overwrite", (*_RUN, "--overwrite"), ("R",), (*_RUN, "--seed", "7"), later=_READERS),
        Job("simulate", _SIMULATE, ("S",), overwrite=True, continues=(".S.partial",)),
        Job("simulate --overwrite", (*_SIMULATE, "--overwrite"), ("S",), (*_SIMULATE, "--seed", "7"),
            continues=(".S.partial",)),
        Job("compare", ("compare", "{stage}/compare.yaml", "--run", "{stage}/R", "-o", "{place}/D"), ("D",),
            resumes=True),
        Job("train", _TRAIN, ("T", "corpus"), inputs=("corpus",), resumes=True),
        Job("plan", (*_PLAN, "--confidence", "0.95"), ("P",), (*_PLAN, "--confidence", "0.9")),
        Job("export", ("export", "{stage}/R", "--to", "urdf", "-o", "{place}/u.urdf", "--pieces", "2"),
            ("u.urdf", "u.urdf_meshes"),
            ("export", "{stage}/R", "--to", "urdf", "-o", "{place}/u.urdf", "--pieces", "1")),
        Job("report", ("report", "{stage}/R", "-o", "{place}/page.html"), ("page.html",),
            ("report", "{stage}/R", "{stage}/R", "-o", "{place}/page.html")),
        Job("evaluate", ("evaluate", "{place}/R", "{stage}/S"), ("R",), inputs=("R",),
            later=(("report", "{place}/R", "-o", "{stage}/later.html"),)),
        Job("observability", ("observability", "{stage}/R", "-o", "{place}/O"), ("O",),
            ("observability", "{stage}/R", "-o", "{place}/O", "--sigma-px", "2")),
        Job("predict", ("predict", "{stage}/R", "--horizon", "5", "-o", "{place}/p.csv"), ("p.csv",),
            ("predict", "{stage}/R", "--horizon", "3", "-o", "{place}/p.csv")),
        Job("calibrate", _CALIBRATE, ("B",), (*_CALIBRATE, "--model", "brown8")),
        Job("checkout", _CHECKOUT, ("C",), (*_CHECKOUT, "--rig", "{stage}/S/mav0")),
        Job("import", _IMPORT, ("I",), later=_CHECKED, overwrite=True, continues=(".I.partial",)),
        Job("import --overwrite", (*_IMPORT, "--crop", "4,4,192,152", "--overwrite"), ("I",),
            (*_IMPORT, "--every", "2"), later=_CHECKED, continues=(".I.partial",)),
    )
}  # fmt: skip

STAGE = ROOT / "runs" / "kills"
COMPARE = """
compare:
  limit_s: 120
  total_s: 900
  solvers: [gauss_newton, gauss_newton_ratios, odometry]
"""
TRAIN = """
seed: 2
runtime: {workers: 2}
train:
  task: descriptor
  corpus: {seed: 3, scenes: 2, frames: 3, validation_every: 2, families: [free_flyer], other_material: 0.0,
           turn_deg: [15.0, 20.0], sun_phase_deg: [10.0, 40.0], span_px: [240.0, 260.0], earth_behind: 0.0,
           lamp: 0.0, stars: 0.0}
  schedule: {steps: 12, warmup_steps: 1, checkpoint_every: 2, validate_every: 6, log_every: 1}
  descriptor: {batch: 48, frame_pairs: 2}
"""


@dataclass(frozen=True)
class Stage:
    """A folder with the inputs, an undisturbed result of each command, and the folders of the cases."""

    folder: Path

    @property
    def cases(self) -> Path:
        """Where the cases are laid out."""
        return self.folder / "cases"

    def undisturbed(self, job: Job) -> dict[str, Any]:
        """Of the command: seconds, changes of names, bytes, the largest file; digests of its results."""
        return dict(json.loads((self._of(job) / "undisturbed.json").read_text()))

    def expected(self, job: Job) -> list[str]:
        """The names that may be in the folder of a case at the end; a failed run stays beside a good one."""
        return [*job.results, *job.inputs, *(f"{name}.failed" for name in job.results)]

    def lay_out(self, job: Job, place: Path) -> None:
        """Fill the folder of a case with what the command finds, and nothing else."""
        for path in place.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        for source in (
            *(self.folder / name for name in job.inputs),
            *sorted((self._of(job) / "old").iterdir()),
        ):
            if source.is_dir():
                shutil.copytree(source, place / source.name, symlinks=True)
            else:
                shutil.copy2(source, place / source.name)

    def filled_in(self, words: Words, place: Path) -> list[str]:
        """The words of a command line for the folder of a case."""
        return [word.format(stage=self.folder, place=place) for word in words]

    def call(self, words: Words, place: Path) -> tuple[int, str, str]:
        """Run a command in this process: exit code, standard output and error."""
        out, error = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
            code = main(self.filled_in(words, place))
        return code, out.getvalue(), error.getvalue()

    def state_of(self, job: Job, place: Path) -> State:
        """What is left of the command's results in the folder of a case."""
        known = self.undisturbed(job)
        try:
            now = contents(place, job.results)
        except ValueError:
            return "lost" if known["old"] else "half"
        if job.name.startswith("run") and is_failed_run(place / "R") and now != known["old"]:
            return "lost" if known["old"] else "failed"
        return judged(now, known["old"], known["new"], job.resumes)

    def differences(self, job: Job, place: Path) -> list[str]:
        """The files of the results that are not those of an undisturbed command."""
        now, new = contents(place, job.results), self.undisturbed(job)["new"]
        return sorted(name for name in now.keys() | new.keys() if now.get(name) != new.get(name))

    def make(self, job: Job) -> None:
        """Run the command undisturbed, after the one whose result it replaces."""
        own, place = self._of(job), self.cases / "undisturbed"
        shutil.rmtree(own, ignore_errors=True)
        shutil.rmtree(place, ignore_errors=True)
        (own / "old").mkdir(parents=True)
        place.mkdir(parents=True)
        self.lay_out(job, place)
        if job.before:
            self.require(job.before, place)
            for path in sorted(place.iterdir()):
                path.rename(own / "old" / path.name)
            self.lay_out(job, place)
        # An input in which the command writes is an earlier result, too.
        old = contents(place, job.results) if not job.resumes else {}
        seen, changes, begin = names_of(place), 0, time.monotonic()
        program = subprocess.Popen(
            [sys.executable, "-m", "polhode", *self.filled_in(job.words, place)],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
        )
        while program.poll() is None:
            if (now := names_of(place)) != seen:
                seen, changes = now, changes + 1
            time.sleep(0.002)
        if program.returncode:
            raise SystemExit(f"{job.name}: the undisturbed command ends with {program.returncode}")
        files = [path for name in job.results for path in (place / name, *(place / name).rglob("*"))]
        sizes = [path.stat().st_size for path in files if path.is_file()]
        known = {
            "seconds": time.monotonic() - begin,
            "changes": max(changes, 1),
            "bytes": sum(sizes),
            "largest": max(sizes),
            "old": old,
            "new": contents(place, job.results),
        }
        (own / "undisturbed.json").write_text(json.dumps(known, indent=1))
        shutil.rmtree(place)

    def _of(self, job: Job) -> Path:
        return self.folder / "jobs" / job.name.replace(" ", "_")

    def require(self, words: Words, place: Path) -> None:
        """Run a command that must succeed."""
        code, _, error = self.call(words, place)
        if code:
            raise SystemExit(f"{' '.join(words)}: exit code {code}: {error}")


def prepared(folder: Path, jobs: tuple[str, ...]) -> Stage:
    """The stage, made as far as it is missing. One of other code must be removed first."""
    stage = Stage(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "compare.yaml").write_text(COMPARE)
    (folder / "train.yaml").write_text(TRAIN)
    inputs = {
        "S": ("simulate", "{stage}/scene.yaml", "-o", "{stage}/S"),
        "R": ("run", "--data", "{stage}/S", "-o", "{stage}/R", "--runtime.workers", "2"),
        "corpus": (
            *("train", "{stage}/train.yaml", "--train.output", "{stage}/T"),
            *("--train.corpus.folder", "{stage}/corpus"),
        ),
    }
    needed = {name for name in (*inputs, "boards") for job in jobs if JOBS[job].reads(name)}
    needed |= {"S"} if "R" in needed else set()
    for name, words in inputs.items():
        if not (folder / name).exists() and name in needed:
            print(f"preparing {name}", file=sys.stderr, flush=True)
            stage.require(words, folder)
            if name == "corpus":
                # One scene is rendered in each case, the other one is there.
                shutil.rmtree(folder / "corpus" / "0001")
                shutil.rmtree(folder / "corpus" / "points")
    if not (folder / "boards").exists() and "boards" in needed:
        write_boards(folder / "boards")
    for name in jobs:
        if not (stage._of(JOBS[name]) / "undisturbed.json").is_file():
            print(f"preparing {name}", file=sys.stderr, flush=True)
            stage.make(JOBS[name])
    return stage
