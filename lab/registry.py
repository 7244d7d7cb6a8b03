"""The registry of benchmarks: what ``python -m lab`` and ``make bench`` can run, in this order.

What a benchmark prints is said by the first sentence of its module; ``python -m lab --list`` shows it.
"""

import ast
from dataclasses import dataclass
from importlib.util import find_spec

from lab.command import ROOT


@dataclass(frozen=True)
class Benchmark:
    """One command with the arguments that the project gives it."""

    name: str
    module: str
    """Within ``lab``"""
    page: str
    """That quotes what it prints; empty: none does"""
    minutes: float
    """Roughly, of one core, in full"""
    full: str = ""
    """Arguments"""
    short: str | None = "--short"
    """Arguments of the short form, which takes seconds; None: there is none"""
    needs: tuple[str, ...] = ()
    """Folders (with a slash) and Python packages without which it is skipped"""

    @property
    def topic(self) -> str:
        """The folder of the module."""
        return self.module.partition(".")[0]

    @property
    def prints(self) -> str:
        """The first sentence of the module's docstring."""
        path = ROOT / "lab" / self.module.replace(".", "/")
        path = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
        text = ast.get_docstring(ast.parse(path.read_text())) or ""
        return " ".join(text.split("\n\n")[0].split())

    def words(self, short: bool = False) -> list[str]:
        """Of the command line, after ``python``."""
        return ["-m", f"lab.{self.module}", *((self.short or "") if short else self.full).split()]

    def missing(self, short: bool = False) -> str:
        """The first missing requirement; empty: none. Short forms need no runs and no sequences of data/."""
        for need in self.needs:
            if short and need.startswith(("runs/", "data/")):
                continue
            if not ((ROOT / need).exists() if "/" in need else find_spec(need)):
                return f"needs {need}"
        return ""


SAMPLE_RUN = "runs/demo"
"""The run of the sample that short forms read: that of `make demo`, which ``python -m lab --short`` makes."""
LONGEST = (
    *("cost", "disturbances", "keep_out", "live", "long"),
    *("missions", "robustness", "rotations", "window"),
)
"""Names of those whose short form takes more than nine seconds of the processor: `.ci/run` leaves them out"""
_WITH_TRUTH = ("ts38", "major_axis", "fast_20rpm", "asteroid")


def _of_runs(
    name: str, module: str, page: str, minutes: float, scenes: tuple[str, ...], form: str, more: str = ""
) -> Benchmark:
    """A benchmark of runs/SCENE and data/SCENE, which lab.end_to_end.scenes makes.

    ``form``: arguments with {runs}, {sequences} and {pairs} (RUN:SEQUENCE) for them; the short form takes the
    sample, and ``more`` besides.
    """

    def filled(runs: list[str], sequences: list[str]) -> str:
        pairs = " ".join(map(":".join, zip(runs, sequences, strict=True)))
        return form.format(runs=" ".join(runs), sequences=" ".join(sequences), pairs=pairs)

    runs, sequences = ([f"{folder}/{each}" for each in scenes] for folder in ("runs", "data"))
    short = f"{filled([SAMPLE_RUN], ['examples/sample'])} {more}"
    return Benchmark(name, module, page, minutes, filled(runs, sequences), short, (*runs, *sequences))


BENCHMARKS = (
    Benchmark("pages", "pages", "docs/testing.md", 1, short=""),
    Benchmark("scenes", "end_to_end.scenes", "docs/scenes.md", 240, short=f"--run {SAMPLE_RUN}"),
    Benchmark("thesis", "end_to_end.thesis", "README.md", 3,
              short=f"--run {SAMPLE_RUN} --sequence examples/sample"),
    Benchmark("against_slam", "end_to_end.against_slam", "README.md", 15, "--scenes sample closed_tumble",
              "--short --record runs/short/records/against_slam"),
    Benchmark("cost", "end_to_end.cost", "docs/validation.md", 10,
              short="--short --record runs/short/records/cost"),
    Benchmark("footprint", "end_to_end.footprint", "README.md", 2,
              short="--short --record runs/short/records/footprint"),
    Benchmark("report_picture", "end_to_end.report_picture", "docs/checks.md", 1,
              "runs/sample --section checks -o runs/report_panel.png",
              f"{SAMPLE_RUN} --section checks -o runs/short/report_panel.png",
              ("runs/sample", "/usr/bin/chromium", "playwright")),
    _of_runs("prediction_error", "end_to_end.prediction_error", "docs/planning.md", 1, ("ts38",),
             "{runs} {sequences} -o runs/prediction.png"),
    Benchmark("orekit_messages", "end_to_end.orekit_messages", "docs/exports.md", 1,
              "runs/sample", SAMPLE_RUN, ("orekit_jpype", "/usr/bin/java")),
    Benchmark("temple", "end_to_end.photographs", "docs/validation.md", 15,
              "data/temple --run runs/temple",
              f"examples/sample --run {SAMPLE_RUN} --box None", ("data/temple",)),
    Benchmark("random_rigs", "calibration.random_rigs", "docs/calibrate.md", 30,
              short="--short --workers 1 --record runs/short/records/random_rigs"),
    Benchmark("live", "live.latency", "docs/live.md", 40, short="--short --record runs/short/records/live"),
    Benchmark("long", "live.long", "docs/live.md", 25, short="--short --record runs/short/records/long"),
    Benchmark("clock", "live.clock", "docs/live.md", 12, short="--short --record runs/short/records/clock"),
    Benchmark("matching", "frontend.matching", "docs/frontend.md", 120,
              short="--short --record runs/short/records/matching"),
    Benchmark("disparity", "frontend.disparity", "docs/mapping.md", 60),
    Benchmark("masks", "frontend.masks", "docs/masks.md", 3),
    Benchmark("networks", "frontend.networks", "docs/model_card.md", 10),
    Benchmark("feature_noise", "frontend.feature_noise", "", 30),
    _of_runs("mesh_quality", "mapping.mesh_quality", "docs/mapping.md", 20,
             ("ts38", "asteroid", "major_axis", "specular_mli"), "{sequences} --runs {runs}", "--frames 12"),
    _of_runs("lengths", "mapping.lengths", "docs/mapping.md", 1, ("ts38",), "{runs} {sequences}"),
    _of_runs("fusion_peers", "mapping.fusion_peers", "docs/mapping.md", 40,
             ("ts38", "asteroid", "major_axis", "specular_mli"), "{sequences}", "--frames 4"),
    Benchmark("lie_rank", "solvers.lie_rank", "docs/backend.md", 1, short=""),
    Benchmark("against_mitsuba", "rendering.against_mitsuba", "docs/simulation.md", 20, "-o runs/mitsuba.png",
              "--width 64 --samples 64", ("mitsuba",)),
    Benchmark("bound", "monte_carlo.bound", "docs/accuracy.md", 2, short=""),
    Benchmark("window", "monte_carlo.window", "docs/live.md", 30,
              short="--short --record runs/short/records/window"),
    Benchmark("disturbances", "monte_carlo.disturbances", "docs/backend.md", 60,
              short="--short --record runs/short/records/disturbances"),
    Benchmark("robustness", "monte_carlo.robustness", "docs/accuracy.md", 60,
              short="--short --record runs/short/records/robustness"),
    Benchmark("convergence", "monte_carlo.convergence", "docs/accuracy.md", 40,
              short="--short --workers 1 --record runs/short/records/convergence"),
    Benchmark("rotations", "monte_carlo.rotations", "docs/backend.md", 10,
              short="--short --workers 1 --record runs/short/records/rotations"),
    Benchmark("calibration_errors", "monte_carlo.calibration", "docs/backend.md", 12,
              short="--short --workers 1 --record runs/short/records/calibration"),
    Benchmark("accuracy_estimated", "monte_carlo.accuracy", "docs/accuracy.md", 30,
              "--motions 6 --seeds 20 --estimated", None),
    Benchmark("accuracy", "monte_carlo.accuracy", "docs/accuracy.md", 120, "--motions 6",
              short="--short --workers 1 --record runs/short/records/accuracy"),
    _of_runs("observability_of_run", "edges.observability_of_run", "docs/observability.md", 5, _WITH_TRUTH,
             "{pairs}"),
    Benchmark("expected_errors", "edges.expected_errors", "docs/observability.md", 400,
              short="--short --record runs/short/records/expected_errors"),
    Benchmark("fuzz", "robustness.fuzzing", "docs/testing.md", 340),
    Benchmark("kills", "robustness.kills", "docs/testing.md", 60,
              short="--short --record runs/short/records/kills"),
    Benchmark("leaks", "robustness.leaks", "docs/testing.md", 60),
    Benchmark("leaks_images", "robustness.leaks", "docs/testing.md", 20, "images", "images --short"),
    Benchmark("faults", "robustness.data_faults", "docs/trust.md", 240,
              short="--short --record runs/short/records/faults"),
    Benchmark("measurement_faults", "robustness.measurement_faults", "docs/checks.md", 60,
              short="--short --record runs/short/records/measurement_faults"),
    Benchmark("study_findings", "studies.findings", "lab/studies/README.md", 1, short=""),
    Benchmark("rules_of_thumb", "studies.rules_of_thumb", "docs/expect.md", 240,
              "runs/rules -o runs/rules_of_thumb.yaml --held-back 30",
              "docs/study_results/random_scenes --stored --held-back 30"),
    Benchmark("expectations", "studies.expectations", "docs/expect.md", 1, short=""),
    Benchmark("missions", "missions.missions", "docs/trust.md", 240,
              short="--short --record runs/short/records/missions"),
    Benchmark("keep_out", "missions.keep_out", "docs/planning.md", 320,
              short="--short --record runs/short/records/keep_out"),
    Benchmark("mutation", "mutation.catch", "docs/testing.md", 30),
)  # fmt: skip
"""The scenes come first: they make the runs that others need."""


def chosen(words: tuple[str, ...]) -> list[Benchmark]:
    """Benchmarks of these topics and names, in the order of the registry; all if there are none.

    Raises SystemExit for a word that is neither.
    """
    known = {word for each in BENCHMARKS for word in (each.name, each.topic)}
    for word in words:
        if word not in known:
            topics = ", ".join(dict.fromkeys(each.topic for each in BENCHMARKS))
            raise SystemExit(f"{word}: no such benchmark; the topics are {topics}; --list shows the names")
    return [each for each in BENCHMARKS if not words or {each.name, each.topic} & set(words)]
