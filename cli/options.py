"""What several commands have in common: the type of a command, and the types of shared options."""

import math
from pathlib import Path
from typing import Annotated, Protocol

from tyro.conf import AvoidSubcommands, FlagConversionOff, FlagCreatePairsOff, Positional, arg

from polhode.config import Config
from polhode.errors import InputError

ConfigFile = Annotated[Positional[Path], arg(metavar="CONFIG")]
OptionalConfigFile = Annotated[Positional[Path | None], arg(metavar="CONFIG")]
ConfigValues = Annotated[AvoidSubcommands[FlagConversionOff[Config]], arg(name="")]
"""The configuration itself: the help lists its keys as options, which ``overrides`` reads."""
Flag = FlagCreatePairsOff[bool]
Debug = Annotated[FlagCreatePairsOff[bool], arg(help="Show the traceback of an error.")]


def require_positive(command: object, *names: str, most: float = 1e12) -> None:
    """Raises InputError for an option that is not a number above 0 and at most ``most``."""
    for name in names:
        value = getattr(command, name)
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number above 0")
        if not 1.0 / 1e12 <= value <= most:
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number from 1e-12 to {most:g}")


class Command(Protocol):
    """What the command line is parsed into."""

    def execute(self) -> int:
        """Run the command and return the exit code."""
        ...
