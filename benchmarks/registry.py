"""The registry of benchmarks: what ``python -m benchmarks`` and ``make bench`` can run, in this order.

What a benchmark prints is said by the first sentence of its module; ``python -m benchmarks --list`` shows it.
"""

import ast
from dataclasses import dataclass
from importlib.util import find_spec

from benchmarks.command import ROOT

ALL = ("backend", "compare", "frontend", "mapping", "pipeline", "planning", "simulation", "train", "polhode")
CODE: dict[str, tuple[str, ...]] = {
    "calibration": ("calibration", "polhode"),
    "end_to_end": ("backend", "frontend", "mapping", "pipeline", "simulation", "polhode"),
    "checkout": ("frontend", "pipeline/checkout", "pipeline/data_checks", "polhode"),
    "frontend": ("frontend", "simulation", "polhode"),
    "live": ("backend", "frontend", "pipeline", "polhode"),
    "viewer": ("pipeline/view", "pipeline/live", "polhode"),
    "mapping": ("frontend", "mapping", "simulation", "polhode"),
    "importers": (*ALL, "importers", "cli"),
    "intervals": ("backend", "pipeline/intervals", "simulation/monte_carlo.py", "polhode"),
    "monte_carlo": ("backend", "simulation/monte_carlo.py", "polhode"),
    "solvers": ("backend", "compare", "simulation/monte_carlo.py", "polhode"),
    "edges": ("planning/edges", "simulation", "polhode"),
    "navigation": ("planning/edges", "planning/prediction.py", "benchmarks/edges", "simulation", "polhode"),
    "planning": ("planning", "simulation", "polhode"),
    "rendering": ("simulation", "polhode"),
    "robustness": (*ALL, "cli"),
    "studies": ("studies", "polhode"),
    "trust": (*ALL, "benchmarks/robustness"),
    "mutation": (*ALL, "cli", "tests"),
}
"""By topic: the folders and files whose changes make a stored result old, besides the topic's own folder."""


@dataclass(frozen=True)
class Benchmark:
    """One command with the arguments that the project gives it."""

    name: str
    module: str
    """Within ``benchmarks``"""
    page: str
    """That quotes what it prints; empty: none does"""
    minutes: float
    """Roughly, of one core, in full"""
    full: str = ""
    """Arguments"""
    short: str | None = "--short"
    """Arguments of the small version; None: there is none"""
    needs: tuple[str, ...] = ()
    """Folders (with a slash) and Python packages without which it is skipped"""

    also: str = ""
    """Another topic that it belongs to"""

    @property
    def topic(self) -> str:
        """The folder of the module."""
        return self.module.partition(".")[0]

    @property
    def prints(self) -> str:
        """The first sentence of the module's docstring."""
        path = ROOT / "benchmarks" / self.module.replace(".", "/")
        path = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
        text = ast.get_docstring(ast.parse(path.read_text())) or ""
        return " ".join(text.split("\n\n")[0].split())

    def arguments(self, short: bool) -> list[str] | None:
        """Of the command line; None: it has no small version."""
        if not short:
            return self.full.split()
        return None if self.short is None else self.short.split()

    def missing(self, short: bool) -> str:
        """The first missing requirement; empty: none. Small versions need no runs."""
        for need in self.needs:
            if short and need.startswith(("runs/", "data/")):
                continue
            if not ((ROOT / need).exists() if "/" in need else find_spec(need)):
                return need
        return ""


_THREE = "runs/ts38 runs/asteroid runs/pure_spin"
_SURFACES = "data/ts38 data/asteroid data/major_axis data/specular_mli"
_BY_SOLVER = "runs/ts38 runs/asteroid runs/hard_light runs/specular_mli runs/pure_spin"
_WITH_TRUTH = " ".join(
    f"runs/{each}:data/{each}" for each in ("ts38", "major_axis", "fast_20rpm", "asteroid")
)
_TS38 = ("runs/ts38", "data/ts38")
_TEMPLE = "../shared/data/photographs/temple"


def _of_runs(
    name: str, module: str, page: str, minutes: float, runs: str, more: str = "", also: str = ""
) -> Benchmark:
    """A benchmark of stored runs or sequences, which has no small version."""
    needs = tuple(word for pair in runs.split() for word in pair.split(":"))
    return Benchmark(name, module, page, minutes, f"{runs} {more}", None, needs, also)


BENCHMARKS = (
    Benchmark("scenes", "end_to_end.scenes", "docs/scenes.md", 240, short=None),
    Benchmark("range_images", "end_to_end.range_images", "docs/dataset.md", 15,
              short="--frames 12 --record runs/records/range_images_short"),
    _of_runs("prediction_error", "end_to_end.prediction_error", "docs/planning.md", 1,
             "runs/ts38 data/ts38", "-o runs/prediction.png"),
    _of_runs("readme_picture", "end_to_end.readme_picture", "README.md", 1,
             "runs/ts38 data/ts38", "-o runs/overview.png"),
    Benchmark("report_page", "end_to_end.report_page", "docs/report.md", 2, "runs/demo", None,
              ("runs/demo", "/usr/bin/chromium", "playwright")),
    _of_runs("animation", "end_to_end.animation", "README.md", 5,
             "runs/closed_tumble data/closed_tumble", "-o runs/tumbling.webp"),
    Benchmark("thesis", "end_to_end.thesis", "README.md", 3, short=None),
    Benchmark("against_slam", "end_to_end.against_slam", "README.md", 15, "--scenes sample closed_tumble",
              "--record runs/records/against_slam_short"),
    Benchmark("footprint", "end_to_end.footprint", "README.md", 2, short=None),
    Benchmark("report_picture", "end_to_end.report_picture", "docs/checks.md", 1,
              "runs/sample --section checks -o runs/report_panel.png", None,
              ("runs/sample", "/usr/bin/chromium")),
    _of_runs("keepout", "planning.keepout", "docs/planning.md", 60, _THREE),
    _of_runs("keepout_truth", "planning.keepout", "docs/planning.md", 20, _THREE, "--truth"),
    _of_runs("collision_pieces", "planning.collision_pieces", "docs/exports.md", 30, "runs/ts38"),
    Benchmark("random_rigs", "calibration.random_rigs", "docs/calibrate.md", 30),
    Benchmark("real_pairs", "calibration.real_pairs", "docs/calibrate.md", 2, "data/chessboard_pairs", None,
              ("data/chessboard_pairs",)),
    Benchmark("live", "live", "docs/live.md", 40),
    Benchmark("viewer_latency", "viewer.latency", "docs/report.md", 4, needs=("rerun",)),
    _of_runs("viewer_picture", "viewer.picture", "docs/report.md", 1,
             "runs/demo sample", "-o runs/viewer.png"),
    Benchmark("long", "live.long", "docs/live.md", 25, "-o docs/images/long.png"),
    Benchmark("start", "live.start", "docs/speed.md", 4),
    Benchmark("stages", "live.stages", "docs/speed.md", 8),
    Benchmark("checkout", "checkout.sequences", "docs/checkout.md", 10),
    _of_runs("run_cost", "checkout.run_cost", "docs/checkout.md", 1, _WITH_TRUTH),
    Benchmark("temple", "end_to_end.photographs", "docs/validation.md", 15,
              f"{_TEMPLE} --run runs/temple -o runs/temple.png", None, (_TEMPLE,)),
    Benchmark("turntable", "end_to_end.turntable", "docs/validation.md", 1,
              "data/turntable data/turntable/matrices.mat -o runs/turntable", None, ("data/turntable",)),
    Benchmark("backgrounds", "end_to_end.backgrounds", "docs/masks.md", 60),
    Benchmark("matching", "frontend.matching", "docs/frontend.md", 120),
    Benchmark("votes", "frontend.votes", "docs/frontend.md", 8),
    Benchmark("loss_terms", "frontend.loss_terms", "docs/training.md", 180),
    Benchmark("frontend_cost", "frontend.cost", "docs/frontend.md", 2, needs=("data/ts38",)),
    Benchmark("reliability", "frontend.reliability", "docs/model_card.md", 15),
    Benchmark("leading", "frontend.leading", "docs/frontend.md", 160, "runs/front_ends_of_scenes", None),
    Benchmark("failures", "frontend.failures", "docs/model_card.md", 15, "-o runs/frontend_failures.webp"),
    Benchmark("disparity", "frontend.disparity", "docs/depth.md", 60),
    Benchmark("disparity_start", "frontend.disparity_start", "docs/depth.md", 15),
    Benchmark("masks", "frontend.masks", "docs/masks.md", 3),
    _of_runs("mesh_quality", "mapping.mesh_quality", "docs/mapping.md", 20, _SURFACES),
    _of_runs("mesh_sigma", "mapping.mesh_sigma", "docs/mapping.md", 5, _WITH_TRUTH, also="trust"),
    Benchmark("lengths", "mapping.lengths", "docs/mapping.md", 1, short=None, needs=_TS38),
    Benchmark("fusion_peers", "mapping.fusion_peers", "docs/mapping.md", 40, needs=tuple(_SURFACES.split())),
    Benchmark("fusion_scale", "mapping.fusion_scale", "docs/mapping.md", 10),
    Benchmark("frame_time", "mapping.frame_time", "docs/mapping.md", 5, needs=("data/ts38", "data/asteroid")),
    Benchmark("lie_rank", "solvers.lie_rank", "docs/backend.md", 1, short=""),
    Benchmark("conditioning", "solvers.conditioning", "docs/backend.md", 1, "-o runs/conditioning.png",
              "-o runs/conditioning.png"),
    Benchmark("backend_size", "solvers.backend_size", "docs/accuracy.md", 15, "-o runs/backend_growth.png",
              "--short -o runs/backend_growth.png"),
    _of_runs("runs_by_solver", "solvers.runs_by_solver", "docs/backend.md", 10, _BY_SOLVER),
    Benchmark("compare", "solvers.compare", "docs/compare.md", 180),
    Benchmark("pose_graph", "solvers.pose_graph", "docs/architecture.md", 2, needs=("gtsam",)),
    Benchmark("intervals", "intervals.truth_inside", "docs/run_directory.md", 10, also="trust"),
    Benchmark("same_run", "importers.same_run", "docs/import.md", 6, needs=("av", "rosbags")),
    Benchmark("clock_offset", "importers.clock_offset", "docs/import.md", 15),
    Benchmark("bound", "monte_carlo.bound", "docs/accuracy.md", 2, short=""),
    Benchmark("window", "monte_carlo.window", "docs/live.md", 30),
    Benchmark("window_estimated", "monte_carlo.window", "docs/live.md", 20, "--seeds 3 --estimated",
              "--estimated --short"),
    Benchmark("disturbances", "monte_carlo.disturbances", "docs/backend.md", 15),
    Benchmark("robustness", "monte_carlo.robustness", "docs/accuracy.md", 60),
    Benchmark("convergence", "monte_carlo.convergence", "docs/accuracy.md", 40),
    Benchmark("accuracy_estimated", "monte_carlo.accuracy", "docs/accuracy.md", 30,
              "--motions 6 --seeds 20 --estimated", "--estimated --short"),
    Benchmark("accuracy", "monte_carlo.accuracy", "docs/accuracy.md", 120, "--motions 6"),
    Benchmark("observability_speed", "edges.observability_speed", "docs/observability.md", 5),
    _of_runs("observability_of_run", "edges.observability_of_run", "docs/observability.md", 5, _WITH_TRUTH),
    Benchmark("planned_approaches", "edges.planned_approaches", "docs/observability.md", 90),
    Benchmark("expected_errors", "edges.expected_errors", "docs/observability.md", 400),
    Benchmark("inspect_and_approach", "navigation.inspect_and_approach", "docs/observability.md",
              90, short="--short --record runs/records/inspect_and_approach_short"),
    Benchmark("refined_edges", "navigation.refined_edges", "docs/observability.md", 3, short=None),
    Benchmark("against_mitsuba", "rendering.against_mitsuba", "docs/simulation.md", 20, "-o runs/mitsuba.png",
              "--width 64 --samples 64", ("mitsuba",)),
    Benchmark("rendering_time", "rendering.rendering_time", "docs/simulation.md", 20),
    Benchmark("fuzz", "robustness.fuzzing", "docs/testing.md", 340),
    Benchmark("kills", "robustness.kills", "docs/testing.md", 60),
    Benchmark("leaks", "robustness.leaks", "docs/testing.md", 60),
    Benchmark("leaks_images", "robustness.leaks", "docs/testing.md", 20, "images", "images --short"),
    Benchmark("faults", "robustness.data_faults", "docs/robustness.md", 240),
    Benchmark("measurement_faults", "robustness.measurement_faults", "docs/checks.md", 60),
    Benchmark("verdict", "robustness.verdict", "docs/checks.md", 1, "-o runs/verdict.png", None,
              also="trust"),
    Benchmark("study_findings", "studies.findings", "docs/study_findings.md", 1, short=""),
    Benchmark("rules_of_thumb", "studies.rules_of_thumb", "docs/expect.md", 240,
              "runs/rules -o runs/rules_of_thumb.yaml --held-back 30", "runs/rules_short --short"),
    Benchmark("expectations", "studies.expectations", "docs/expect.md", 1, short=""),
    Benchmark("trust", "trust.trust", "docs/trust.md", 240),
    Benchmark("mutation", "mutation.catch", "docs/testing.md", 30, short=None),
)  # fmt: skip
"""The scenes come first: they make the runs that others need."""


def chosen(words: tuple[str, ...]) -> list[Benchmark]:
    """Benchmarks of these topics and names, in the order of the registry; all if there are none.

    Raises SystemExit for a word that is neither.
    """
    known = {word for each in BENCHMARKS for word in (each.name, each.topic, each.also) if word}
    for word in words:
        if word not in known:
            topics = ", ".join(dict.fromkeys(each.topic for each in BENCHMARKS))
            raise SystemExit(f"{word}: no such benchmark; the topics are {topics}; --list shows the names")
    return [each for each in BENCHMARKS if not words or {each.name, each.topic, each.also} & set(words)]


def code_of(module: str) -> tuple[str, ...]:
    """The folders that a result of a module depends on."""
    parts = module.split(".")
    if parts[0] != "benchmarks" or len(parts) < 2 or parts[1] not in CODE:
        return ALL
    return (*CODE[parts[1]], f"benchmarks/{parts[1]}")
