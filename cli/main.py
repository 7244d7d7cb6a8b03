"""The program ``polhode``: finds the command, loads its configuration and runs it.

Exit code 0: success; 1: the run failed; 2: the user's mistake; 128 + n: ended by signal n. Every error is one
line on standard error.
"""

import contextlib
import dataclasses
import io
import operator
import signal
import sys
import warnings
from collections.abc import Sequence
from itertools import dropwhile, takewhile
from typing import Annotated, Any, Union, cast

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from polhode.cli.calibrate import CalibrateCommand
from polhode.cli.checkout import CheckoutCommand
from polhode.cli.compare import CompareCommand
from polhode.cli.console import is_working, show_warnings
from polhode.cli.evaluate import EvaluateCommand
from polhode.cli.export import ExportCommand
from polhode.cli.failures import explained, printable_traceback
from polhode.cli.import_sequence import ImportCommand
from polhode.cli.observability import ObservabilityCommand
from polhode.cli.options import Command
from polhode.cli.overrides import option_names, split_overrides
from polhode.cli.plan import PlanCommand
from polhode.cli.predict import PredictCommand
from polhode.cli.report import ReportCommand
from polhode.cli.run import RunCommand
from polhode.cli.simulate import SimulateCommand
from polhode.cli.streams import tolerant_streams
from polhode.cli.threshold import ThresholdCommand
from polhode.cli.train import TrainCommand
from polhode.cli.view import ViewCommand
from polhode.code_cache import require_no_settings_of_numba
from polhode.config.keys import is_structured, suggestion
from polhode.config.loader import load_config
from polhode.errors import InputError, RunFailure, one_line
from polhode.interrupts import interrupts_raised, received
from polhode.processes import kill_workers
from polhode.threads import limit_threads

COMMANDS: dict[str, type[Command]] = {
    "simulate": SimulateCommand,
    "calibrate": CalibrateCommand,
    "checkout": CheckoutCommand,
    "run": RunCommand,
    "evaluate": EvaluateCommand,
    "compare": CompareCommand,
    "predict": PredictCommand,
    "threshold": ThresholdCommand,
    "plan": PlanCommand,
    "observability": ObservabilityCommand,
    "export": ExportCommand,
    "report": ReportCommand,
    "view": ViewCommand,
    "import": ImportCommand,
    "train": TrainCommand,
}
CONFIGURED = (SimulateCommand, RunCommand, CompareCommand, TrainCommand)
"""Those that read a configuration"""
DESCRIPTION = "Motion, mass properties and shape of a tumbling target, from a stereo camera."
RESUMES = {
    "compare": "finished rows are kept, the same command goes on from there",
    "train": "finished scenes and the last checkpoint are kept, the same command goes on from there",
}
"""What an interrupt leaves of a command, where it leaves something"""
ENDED_BY_SIGNAL = 128
"""Added to the number of the signal that ended a program, its exit code."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (by default that of the process) and return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    # Nothing imported so far loads NumPy (tests/cli/test_main.py); the configuration may raise the limit.
    limit_threads(1)
    with tolerant_streams() as streams, interrupts_raised(first=kill_workers):
        code = _run([word for word in words if word != "--debug"], debug)
        sys.stdout.flush()
        if streams.lost and code == 0:
            lost = f"standard output: {streams.lost}: what was printed is lost, the work is complete"
            return _fail(RunFailure.exit_code, lost)
    return code


def _run(words: list[str], debug: bool) -> int:
    """The command; an error as its exit code, after one line on standard error."""
    try:
        with show_warnings(), warnings.catch_warnings():
            if not debug:
                # Of libraries, to programmers: standard error holds one line.
                warnings.simplefilter("ignore")
            return _dispatch(words)
    except KeyboardInterrupt as stop:
        number = received()
        by = f" by {number.name}" if number is not None else ""
        return _fail(ENDED_BY_SIGNAL + (number or signal.SIGINT), _interrupted(words, by, stop), stop, debug)
    except Exception as error:  # noqa: BLE001  last resort: one line instead of a traceback
        return _fail(*explained(error, is_working(), *words[:1]), error, debug)


def _interrupted(words: list[str], by: str, stop: KeyboardInterrupt) -> str:
    """What was interrupted, and what is kept, in the words of the room or of the command."""
    command = words[0] if words and words[0] in COMMANDS else ""
    kept = str(stop).removeprefix("interrupted") if str(stop).startswith("interrupted") else ""
    kept = kept or f"; {RESUMES.get(command, 'nothing was written or replaced')}"
    return " ".join(filter(None, [command, f"interrupted{by}{kept}"]))


def _dispatch(words: list[str]) -> int:
    if words == ["--version"]:
        from importlib.metadata import version

        print(f"polhode {version('polhode')}")
        return 0
    asks_help = any(word in ("-h", "--help") for word in words)
    if not asks_help:
        _require_command(words)
    elif words[0] in COMMANDS:
        # Help wins over everything else on the line, even over mistakes.
        words = [words[0], "--help"]
    _require_no_empty_word(words)
    own, overrides = split_overrides(words)
    command = _parse(own)
    if command is None:
        return 0
    require_no_settings_of_numba()
    if isinstance(command, CONFIGURED):
        values = load_config(command.config, overrides)
        limit_threads(values.runtime.blas_threads)
        command = dataclasses.replace(command, values=values)
    elif overrides:
        raise InputError(f"'{words[0]}' reads no configuration: remove --{next(iter(overrides))}")
    return command.execute()


def _require_no_empty_word(words: list[str]) -> None:
    """Raise InputError: an empty path would be the current folder, and no option takes an empty text."""
    before = ""
    for word in words:
        if not word or (word.startswith("-") and word.endswith("=")):
            where = word.rstrip("=") or (before if before.startswith("-") else f"polhode {words[0]}")
            raise InputError(f"{where}: an empty value was given; is a variable of the shell not set?")
        before = word


def _require_command(words: list[str]) -> None:
    names = ", ".join(COMMANDS)
    if not words:
        raise InputError(f"a command is missing: {names}; see polhode --help")
    if words[0] not in COMMANDS:
        hint = suggestion(words[0], list(COMMANDS))
        raise InputError(f"unknown command '{words[0]}';{hint} commands: {names}; see polhode --help")


def _parse(words: list[str]) -> Command | None:
    """The command with its options; None for ``--help``, which tyro has printed.

    tyro 1.0 has no public access to the text of an error: it draws it in a box on standard error and exits.
    """
    options = [Annotated[cls, tyro.conf.subcommand(name)] for name, cls in COMMANDS.items()]
    union = cast(Any, Union)[tuple(options)]
    stderr = io.StringIO()
    try:
        with contextlib.redirect_stderr(stderr):
            command, unknown = tyro.cli(
                union,
                prog="polhode",
                description=DESCRIPTION,
                args=words,
                return_unknown_args=True,
                registry=_registry(),
            )
    except SystemExit as stop:
        if stop.code in (0, None):
            return None
        # What an option that does not exist leaves for the others, tyro's message is about.
        mistaken = next((word for word in words[1:] if _is_no_option(words[0], word)), None)
        if mistaken is not None:
            raise InputError(_unknown_option(words[0], mistaken)) from None
        raise InputError(f"{squash(stderr.getvalue())}; see polhode {words[0]} --help") from None
    if unknown:
        raise InputError(_unknown_option(words[0], unknown[0]))
    return cast(Command, command)


def _registry() -> ConstructorRegistry:
    """Tell tyro that lists of sections, and mappings, are one word of YAML, which ``overrides`` reads."""
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def structured(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        if not is_structured(info.type):
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar="YAML",
            instance_from_str=lambda words: words[0],
            is_instance=lambda value: isinstance(value, tuple | dict),
            str_from_instance=lambda value: ["{}" if isinstance(value, dict) else "[]"],
        )

    return registry


def _own_options(command: str) -> list[str]:
    """Options of a command beside the keys of the configuration; its positional arguments are among them."""
    names = [each.name for each in dataclasses.fields(cast(Any, COMMANDS[command])) if each.name != "values"]
    return ["--" + name.replace("_", "-") for name in names]


def _is_no_option(command: str, word: str) -> bool:
    name = word.partition("=")[0].replace("_", "-")
    return name.startswith("--") and name not in _own_options(command)


def _unknown_option(command: str, word: str) -> str:
    if not word.startswith("-"):
        return f"unexpected argument '{word}'; see polhode {command} --help"
    name = word.partition("=")[0]
    configured = option_names() if issubclass(COMMANDS[command], CONFIGURED) else []
    hint = suggestion(name, [*_own_options(command), *configured])
    return f"unknown option '{name}';{hint} see polhode {command} --help"


def squash(text: str) -> str:
    """A message that tyro drew as a title and a box, as one line: the title and the text above the next rule.

    Where standard output is not UTF-8, tyro underlines the title with hyphens instead of drawing a box.
    """
    lines = [line.strip("│╭╮╰╯─ ") for line in text.splitlines()]
    rows = iter(line if line.strip("-") else "" for line in lines)
    title = next(filter(None, rows), "this command line cannot be read")
    body = " ".join(takewhile(bool, dropwhile(operator.not_, rows)))
    return " ".join((f"{title}: {body}" if body else title).split())


def _fail(code: int, message: str, error: BaseException | None = None, debug: bool = False) -> int:
    if debug and error is not None:
        sys.stderr.write(printable_traceback(error))
    print(f"polhode: error: {one_line(message)}", file=sys.stderr)
    return code
