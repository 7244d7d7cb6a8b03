"""The program ``polhode``: finds the command, loads its configuration, runs it and shows its answer.

Exit code 0: success; 1: the run failed; 2: the user's mistake; 128 + n: ended by signal n. Every error is one
line on standard error; with --json it is in the answer, too.
"""

import contextlib
import signal
import sys
import warnings
from collections.abc import Sequence

from polhode.cli.answer import Answer, Outcome
from polhode.cli.calibrate import CalibrateCommand
from polhode.cli.checkout import CheckoutCommand
from polhode.cli.compare import CompareCommand
from polhode.cli.completion import CompletionCommand
from polhode.cli.doctor import DoctorCommand
from polhode.cli.evaluate import EvaluateCommand
from polhode.cli.expect import ExpectCommand
from polhode.cli.export import ExportCommand
from polhode.cli.failures import explained, printable_traceback
from polhode.cli.help import command_help, overview
from polhode.cli.import_sequence import ImportCommand
from polhode.cli.observability import ObservabilityCommand
from polhode.cli.options import Command, ConfiguredCommand, GeneralOptions, split_general
from polhode.cli.parsing import parse
from polhode.cli.plan import PlanCommand
from polhode.cli.predict import PredictCommand
from polhode.cli.report import ReportCommand
from polhode.cli.run import RunCommand
from polhode.cli.simulate import SimulateCommand
from polhode.cli.streams import tolerant_streams
from polhode.cli.sweep import SweepCommand
from polhode.cli.threshold import ThresholdCommand
from polhode.cli.train import TrainCommand
from polhode.cli.view import ViewCommand
from polhode.config.keys import suggestion
from polhode.config.loader import load_config
from polhode.runtime.code_cache import require_no_settings_of_numba
from polhode.runtime.console import is_working, show_warnings
from polhode.runtime.errors import InputError, RunFailure, one_line
from polhode.runtime.interrupts import interrupts_raised, received
from polhode.runtime.processes import kill_workers
from polhode.runtime.threads import limit_threads

TOPICS: dict[str, dict[str, type[Command]]] = {
    "data": {
        "simulate": SimulateCommand,
        "import": ImportCommand,
        "calibrate": CalibrateCommand,
        "checkout": CheckoutCommand,
    },
    "estimate": {
        "run": RunCommand,
        "evaluate": EvaluateCommand,
        "report": ReportCommand,
        "view": ViewCommand,
        "compare": CompareCommand,
        "sweep": SweepCommand,
    },
    "use a run": {
        "predict": PredictCommand,
        "plan": PlanCommand,
        "observability": ObservabilityCommand,
        "export": ExportCommand,
        "threshold": ThresholdCommand,
        "expect": ExpectCommand,
    },
    "program": {"train": TrainCommand, "doctor": DoctorCommand, "completion": CompletionCommand},
}
COMMANDS = {name: command for topic in TOPICS.values() for name, command in topic.items()}
RESUMES = {
    "compare": "finished rows are kept, the same command goes on from there",
    "sweep": "points that are done are kept, the same command goes on from there",
    "train": "finished scenes and the last checkpoint are kept, the same command goes on from there",
}
"""What an interrupt leaves of a command, where it leaves something"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (by default that of the process) and return the exit code."""
    general, words = split_general(sys.argv[1:] if arguments is None else arguments)
    # Nothing imported so far loads NumPy (tests/cli/test_main.py); the configuration may raise the limit.
    limit_threads(1)
    with tolerant_streams() as streams, interrupts_raised(first=kill_workers):
        code = _call(words, general)
        sys.stdout.flush()
        if streams.lost and code == 0:
            lost = f"standard output: {streams.lost}: what was printed is lost, the work is complete"
            print(_error_line(lost), file=sys.stderr)
            return RunFailure.exit_code
    return code


def _call(words: list[str], general: GeneralOptions) -> int:
    """Run the command and show how it ended. Returns the exit code."""
    # Whatever else is printed, by libraries too: a program that reads JSON gets nothing but the answer.
    aside = contextlib.redirect_stdout(sys.stderr) if general.json_answer else contextlib.nullcontext()
    with aside, show_warnings(general.quiet, general.verbose) as warned:
        outcome = _outcome(words, general)
    if general.json_answer:
        print(outcome.as_json(warned))
    elif outcome.answer is not None:
        lines = [outcome.answer.line] if general.quiet else [outcome.answer.text, outcome.answer.line]
        # what a name has that is no UTF-8 is shown as an escape, wherever this goes
        print("\n".join(filter(None, lines)).encode(errors="backslashreplace").decode())
    if outcome.error is not None:
        print(_error_line(outcome.error), file=sys.stderr)
    return outcome.exit_code


def _outcome(words: list[str], general: GeneralOptions) -> Outcome:
    """What becomes of the command: its answer, or an error as exit code and one line."""
    command = words[0] if words and words[0] in COMMANDS else ""
    error: BaseException
    try:
        if general.quiet and general.verbose:
            raise InputError("--quiet and --verbose contradict each other: give one of them")
        with warnings.catch_warnings():
            if not general.debug:
                # Of libraries, to programmers: standard error holds one line. What the caller decided stands.
                warnings.simplefilter("ignore", append=True)
            answer = _dispatch(words)
    except KeyboardInterrupt as stop:
        number = received()
        by = f" by {number.name}" if number is not None else ""
        # what is kept, in the words of the room or of the command
        kept = str(stop).removeprefix("interrupted") if str(stop).startswith("interrupted") else ""
        kept = kept or f"; {RESUMES.get(command, 'nothing was written or replaced')}"
        message = f"{command} interrupted{by}{kept}".lstrip()
        code, error = 128 + (number or signal.SIGINT), stop
    except Exception as raised:  # noqa: BLE001  last resort: one line instead of a traceback
        error = raised
        code, message = explained(raised, is_working(), *words[:1])
    else:
        failure = answer.failure
        return Outcome(command, 0 if failure is None else RunFailure.exit_code, answer, failure)
    if general.debug:
        sys.stderr.write(printable_traceback(error))
    return Outcome(command, code, error=message)


def _dispatch(words: list[str]) -> Answer:
    """Run the command that the words name, or answer with its help."""
    if words == ["--version"]:
        from importlib.metadata import version

        return Answer(f"polhode {version('polhode')}", figures={"version": version("polhode")})
    asked_help = next((word for word in words if word in ("-h", "--help")), None)
    names = ", ".join(COMMANDS)
    if words and words[0] not in COMMANDS and asked_help is None:
        hint = suggestion(words[0], list(COMMANDS))
        raise InputError(f"unknown command '{words[0]}';{hint} commands: {names}; see polhode --help")
    if not words:
        raise InputError(f"a command is missing: {names}; see polhode --help")
    if words[0] not in COMMANDS:
        about = "Motion, mass properties and shape of a tumbling target, from a stereo camera."
        return Answer(overview(about, TOPICS))
    name, *rest = words
    if asked_help is not None:
        # Help wins over everything else on the line, even over mistakes.
        return Answer(command_help(name, COMMANDS[name], everything=asked_help == "--help"))
    before = f"polhode {name}"
    for word in rest:
        # An empty path would be the current folder, and no option takes an empty text.
        if not word or (word.startswith("-") and word.endswith("=")):
            where = word.rstrip("=") or before
            raise InputError(f"{where}: an empty value was given; is a variable of the shell not set?")
        before = word if word.startswith("-") else f"polhode {name}"
    command, overrides = parse(name, COMMANDS[name], rest)
    require_no_settings_of_numba()
    if isinstance(command, ConfiguredCommand):
        values = load_config(command.config, overrides)
        limit_threads(values.runtime.blas_threads)
        command = command.model_copy(update={"values": values})
    elif overrides:
        raise InputError(f"'{name}' reads no configuration: remove --{next(iter(overrides))}")
    return command.execute()


def _error_line(message: str) -> str:
    return f"polhode: error: {one_line(message)}"
