"""The inputs of the disturbed commands, and what each makes when nothing disturbs it."""

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

from benchmarks.command import ROOT
from benchmarks.robustness.disturbed_commands import JOBS, Job, Words
from benchmarks.robustness.results import State, contents, is_failed_run, judged, names_of
from benchmarks.robustness.small_data import write_boards, write_scene
from polhode.cli.main import main

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
            self._require(job.before, place)
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

    def _require(self, words: Words, place: Path) -> None:
        code, _, error = self.call(words, place)
        if code:
            raise SystemExit(f"{' '.join(words)}: exit code {code}: {error}")


def prepared(folder: Path, jobs: tuple[str, ...]) -> Stage:
    """The stage, made as far as it is missing. One of other code must be removed first."""
    stage = Stage(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_scene(folder / "scene.yaml")
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
            stage._require(words, folder)
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
