"""The command line of a benchmark: the parameters of its ``main`` are the options."""

import sys
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, arg

from polhode.threads import limit_threads

ROOT = Path(__file__).resolve().parents[1]
RECORDS = Path(__file__).with_name("records")
"""Records that are kept in the repository: they take hours to measure, on any machine."""

Short = Annotated[bool, arg(help="A small version that takes seconds to minutes.")]
Workers = Annotated[int, arg(help="Processes.")]
Record = Annotated[Path, arg(help="File of what was measured; what it holds is not measured again.")]
Png = Annotated[Path | None, arg(aliases=["-o"], metavar="PNG", help="Draw the figure to this file.")]
Runs = Positional[Annotated[tuple[Path, ...], arg(metavar="RUN", help="Folders of runs.")]]
Sequences = Positional[Annotated[tuple[Path, ...], arg(metavar="SEQ", help="Folders of sequences.")]]


def command(main: Callable[..., None]) -> None:
    """Call ``main`` with the options of the command line; the help is the docstring of its module."""
    module = sys.modules[main.__module__]
    name = module.__spec__.name if module.__spec__ is not None else module.__name__
    tyro.cli(main, prog=f"python -m {name}", description=module.__doc__, config=(FlagCreatePairsOff,))


def single_threaded(work: Callable[..., Any], *arguments: Any) -> Any:
    """Call ``work`` in a new process, which reads the limit of one thread before it loads NumPy."""
    limit_threads(1)
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(work, arguments)
