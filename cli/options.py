"""What several commands have in common: the type of a command, and the types of shared options."""

from pathlib import Path
from typing import Annotated, Protocol

from tyro.conf import AvoidSubcommands, FlagConversionOff, FlagCreatePairsOff, Positional, arg

from polhode.config import Config

ConfigFile = Annotated[Positional[Path], arg(metavar="CONFIG")]
OptionalConfigFile = Annotated[Positional[Path | None], arg(metavar="CONFIG")]
ConfigValues = Annotated[AvoidSubcommands[FlagConversionOff[Config]], arg(name="")]
"""The configuration itself: the help lists its keys as options, which ``overrides`` reads."""
Flag = FlagCreatePairsOff[bool]


class Command(Protocol):
    """What the command line is parsed into."""

    def execute(self) -> int:
        """Run the command and return the exit code."""
        ...
