"""A pickle that executes code when it is read: it makes a file, by which a test sees that it was read."""

import pickle  # noqa: TID251  what the trap is
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Trap:
    """Unpickled, it makes ``sprung``."""

    def __init__(self, sprung: Path) -> None:
        self.sprung = sprung

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.sprung,)


def trap(sprung: Path) -> bytes:
    """The pickle of a trap."""
    return pickle.dumps(Trap(sprung), protocol=2)
