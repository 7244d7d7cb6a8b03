"""What a command answers at its end: lines for people, or a JSON object for programs (docs/command_line.md).

Commands print nothing themselves: they return an ``Answer``, and ``main`` shows it.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from polhode.runtime.errors import one_line

SCHEMA = "polhode-answer/1"
Status = Literal["ok", "degraded", "failed"]
REFUSED, INTERRUPTED = "refused", "interrupted"
"""Status of a call that ended with a user's mistake, or by a signal"""


@dataclass(frozen=True)
class Answer:
    """The result of a command that came to its end."""

    line: str
    """What is printed last, also with --quiet; it names what was written. A command that writes nothing has
    its result here, which may have several lines."""
    text: str = ""
    """Lines before that: tables and notes"""
    paths: tuple[Path, ...] = ()
    """Files and folders that were written, the most important one first"""
    status: Status = "ok"
    figures: Mapping[str, Any] = field(default_factory=dict)
    """Key figures by name, with units in the names"""
    warnings: tuple[str, ...] = ()
    """Those that were not logged while the command worked"""
    failure: str | None = None
    """Why the run failed, although its results were written: exit code 1"""


@dataclass(frozen=True)
class Outcome:
    """How a call ended: with an answer, with an error, or (a failed run) with both."""

    command: str
    """Empty: none was named"""
    exit_code: int
    answer: Answer | None = None
    error: str | None = None

    @property
    def status(self) -> str:
        """That of the answer; without one, what the exit code says."""
        if self.answer is not None:
            return "failed" if self.exit_code else self.answer.status
        if self.exit_code == 0:
            return "ok"
        return {1: "failed", 2: REFUSED}.get(self.exit_code, INTERRUPTED)

    def as_json(self, warnings: Sequence[str]) -> str:
        """One line of JSON: always the same keys. ``warnings``: those that were logged."""
        answer = self.answer or Answer("")
        content = {
            "schema": SCHEMA,
            "command": self.command or None,
            "status": self.status,
            "exit_code": self.exit_code,
            "error": None if self.error is None else one_line(self.error),
            "paths": answer.paths,
            "figures": answer.figures,
            "warnings": list(dict.fromkeys([*warnings, *answer.warnings])),
        }
        return json.dumps(plain(content), allow_nan=False)


def sizes_of(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Files that were written, with their sizes [bytes]."""
    return [{"path": path, "bytes": path.stat().st_size} for path in paths]


def plain(value: Any) -> Any:
    """A value as JSON has it: paths and others as text, arrays as lists, what is not finite as null."""
    if isinstance(value, BaseModel):
        value = value.model_dump()
    elif hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
