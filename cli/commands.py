"""The subcommands of ``polhode``: their options, and what each one calls. Heavy imports wait for the call."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Protocol

from tyro.conf import AvoidSubcommands, FlagConversionOff, FlagCreatePairsOff, Positional, arg

from polhode.cli.compare import Compare
from polhode.cli.console import choose_progress
from polhode.cli.export import Export
from polhode.cli.observability import Observability
from polhode.cli.plan import PlanAhead, Threshold
from polhode.cli.train import TrainNetwork
from polhode.config import Config, Scene
from polhode.errors import InputError, RunFailure
from polhode.threads import limit_threads, processes


class Command(Protocol):
    """What the command line is parsed into."""

    def execute(self) -> int:
        """Do it; the exit code."""
        ...


_Values = Annotated[AvoidSubcommands[FlagConversionOff[Config]], arg(name="")]
_Debug = FlagCreatePairsOff[bool]


@dataclass(frozen=True)
class Simulate:
    """Render a dataset with truth from the scene of a configuration.

    Options with dots override the configuration; the defaults shown are those of a value that the file leaves
    out.
    """

    config: Annotated[Positional[Path], arg(metavar="CONFIG")]
    """Configuration with a scene, YAML."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="SEQ")]
    """Folder of the dataset, to be made."""
    overwrite: FlagCreatePairsOff[bool] = False
    """Replace a dataset that is already there; nothing else is ever replaced."""
    debug: _Debug = False
    """Show the traceback of an error."""
    values: _Values = field(default_factory=lambda: Config(scene=Scene()))

    def execute(self) -> int:
        """Render; the dataset appears when it is complete, and an interrupted one is taken up again."""
        if self.values.scene is None:
            raise InputError(f"{self.config}: no 'scene' to simulate; add one, or extend a file that has it")
        from polhode.simulation.bodies import describe
        from polhode.simulation.dataset.sequence import plan_sequence, require_free, write_sequence

        require_free(self.output, self.overwrite)
        plan = plan_sequence(self.values.scene, self.values.seed)
        print(describe(plan.body), flush=True)
        write_sequence(
            plan, self.output, choose_progress(), processes(self.values.runtime.workers), self.overwrite
        )
        print(f"{len(plan.frames)} stereo pairs with truth: {self.output}")
        return 0


@dataclass(frozen=True)
class Run:
    """Estimate motion, mass properties, map and mesh of the target from a stereo sequence.

    Options with dots override the configuration; the defaults shown are those of a value that the file leaves
    out.
    """

    config: Annotated[Positional[Path], arg(metavar="CONFIG")]
    """Configuration, YAML; configs/default.yaml fits any calibrated sequence."""
    data: Annotated[Path, arg(metavar="SEQ")]
    """Folder of the stereo sequence (it holds mav0/)."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder of the results, to be made."""
    overwrite: FlagCreatePairsOff[bool] = False
    """Replace a run that is already there."""
    debug: _Debug = False
    """Show the traceback of an error."""
    values: _Values = field(default_factory=Config)

    def execute(self) -> int:
        """Run the pipeline; 1 when it failed."""
        from polhode.pipeline.run import run

        try:
            result = run(self.values, self.data, self.output, choose_progress(), overwrite=self.overwrite)
        except RunFailure as failure:
            raise RunFailure(f"{failure}; what was found: {self.output / 'report.html'}") from failure
        print(f"{result.sentence} {result.report_path}")
        if result.failure is not None:
            raise RunFailure(f"{result.failure}; the best motion found: {result.report_path}")
        return 0


@dataclass(frozen=True)
class Evaluate:
    """Compare a run with the truth of its dataset: RUN/metrics.json, a table, a section of the report."""

    run: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a finished run."""
    data: Annotated[Positional[Path], arg(metavar="SEQ")]
    """Folder of the sequence that it was made from, with mav0/target0."""
    debug: _Debug = False
    """Show the traceback of an error."""

    def execute(self) -> int:
        """Write the metrics and print the table."""
        from polhode.pipeline.evaluation.evaluate import evaluate, format_table
        from polhode.pipeline.report import refresh_report

        metrics = evaluate(self.run, self.data)
        refresh_report(self.run)
        print(format_table(metrics))
        return 0


@dataclass(frozen=True)
class Predict:
    """Where the target will be: its state carried on as a free rigid body, with standard deviations.

    Prints a few rows; -o writes them all with the columns of trajectory.csv.
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a finished run."""
    horizon: Annotated[float, arg(metavar="S")]
    """How far to look ahead of the last stereo pair [s]."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="FILE")] = None
    """Table, CSV; with the ending .npz an archive with the full covariances. Replaced if it is there."""
    step_s: Annotated[float | None, arg(metavar="S")] = None
    """Time between two rows [s]; the run's own interval unless given."""
    marks: FlagCreatePairsOff[bool] = False
    """Standard deviations of the body itself: the estimated centre of mass and principal axes are marks on
    it. Finite also where the motion does not determine those."""
    debug: _Debug = False
    """Show the traceback of an error."""

    def execute(self) -> int:
        """Predict, write, print."""
        from polhode.pipeline.products.predict import format_prediction, predict_run, write_prediction

        prediction = predict_run(self.run, self.horizon, self.step_s)
        print(format_prediction(prediction))
        if self.output is not None:
            write_prediction(prediction, self.output, self.marks)
            print(f"Prediction: {self.output}")
        return 0


@dataclass(frozen=True)
class Report:
    """Make the report of a run again, or one page that sets several runs side by side."""

    runs: Annotated[Positional[tuple[Path, ...]], arg(metavar="RUN...")]
    """Folders of runs."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")]
    """The page, HTML; replaced if it is there."""
    debug: _Debug = False
    """Show the traceback of an error."""

    def execute(self) -> int:
        """Write the page."""
        if not self.runs:
            raise InputError(
                "a run is missing: give the folder of one or more runs; see polhode report --help"
            )
        if not self.output.parent.is_dir():
            raise InputError(f"{self.output.parent} is not a folder: choose another -o")
        if self.output.is_dir():
            raise InputError(f"{self.output} is a folder: -o names the page, such as report.html")
        from polhode.pipeline.report import write_comparison, write_report

        if len(self.runs) == 1:
            write_report(self.runs[0], self.output)
        else:
            write_comparison(self.runs, self.output)
        print(f"Report: {self.output}")
        return 0


Configured = Simulate | Run | Compare | TrainNetwork
COMMANDS: dict[
    str,
    type[Simulate]
    | type[Run]
    | type[Evaluate]
    | type[Compare]
    | type[Predict]
    | type[Threshold]
    | type[PlanAhead]
    | type[Observability]
    | type[Export]
    | type[Report]
    | type[TrainNetwork],
] = {
    "simulate": Simulate,
    "run": Run,
    "evaluate": Evaluate,
    "compare": Compare,
    "predict": Predict,
    "threshold": Threshold,
    "plan": PlanAhead,
    "observability": Observability,
    "export": Export,
    "report": Report,
    "train": TrainNetwork,
}


def with_values(command: Configured, values: Config) -> Configured:
    """The command with its configuration loaded; limits the threads before anything heavy is imported."""
    limit_threads(values.runtime.blas_threads)
    return dataclasses.replace(command, values=values)
