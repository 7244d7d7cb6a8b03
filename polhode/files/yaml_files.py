"""Reading YAML that others wrote: configurations, calibrations, values on the command line.

The events of the parser are counted before anything is made of them, so that a file of one kilobyte whose
aliases stand for a billion values, or one nested a million deep, is refused at once. Of YAML's types, those
that no file of ours has are text: dates, numbers in base 60. Keys are text, and a key that stands twice in a
section is an error.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from polhode.files.foreign_files import CONFIGURATION_BYTES, MissingFile, read_text
from polhode.runtime.errors import InputError

MAX_DEPTH = 32
"""Sections and lists within each other; a configuration has 6."""
MAX_VALUES = 200_000
"""Values of a file, those behind its aliases counted wherever they are repeated. A file of the largest size
has fewer than that of any length."""
MAX_NUMBER_LENGTH = 64
"""Characters of a number: 17 digits state a double exactly, and the time of reading many grows with their
square."""
MAX_KEY_LENGTH = 200

_CORE = "tag:yaml.org,2002:"
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufffe\uffff]")


class _Loader(yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader):  # type: ignore[misc]
    """YAML's plain types; keys are the text as it is written.

    libyaml reads ten times as fast as the loader in Python, and words its errors alike.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[str, Any]:
        """A mapping by the text of its keys; those of ``<<`` fill in what the mapping lacks."""
        self.flatten_mapping(node)
        return {str(key.value): self.construct_object(value, deep=True) for key, value in node.value}


_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    (
        "bool",
        r"^(?:yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)$",
        "yYnNtTfFoO",
    ),
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("merge", r"^<<$", "<"),
    ("int", r"^[-+]?(?:0|[1-9][0-9_]*|0b[01_]+|0x[0-9a-fA-F_]+)$", "-+0123456789"),
    (
        "float",
        r"^(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?|[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        "-+0123456789.",
    ),
):
    _Loader.add_implicit_resolver(_CORE + _tag, re.compile(_pattern), list(_first))


def read_yaml(path: Path, missing: str | None = None) -> Any:
    """The content of a YAML file; raises InputError, for a missing file with the message ``missing``."""
    try:
        text = read_text(path, CONFIGURATION_BYTES, "a YAML file")
    except MissingFile:
        raise InputError(missing or f"{path} is missing: give an existing file") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> Any:
    """What the YAML ``text`` says: None, text, numbers, booleans, lists, and mappings with text as keys.

    Raises InputError, one line that begins with ``source`` and the line, for what is not valid, is larger or
    nested deeper than any file of ours, repeats a key, or has a type that none has.
    """
    count = _Count()
    event: Any
    try:
        for event in yaml.parse(text, Loader=_Loader):
            try:
                count.take(event)
            except _Refused as error:
                raise InputError(f"{source} line {event.start_mark.line + 1}: {error}") from None
        return yaml.load(text, Loader=_Loader)  # noqa: S506  a safe loader, restricted further
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "syntax error"
        words = " ".join(problem.split())[:200]
        raise InputError(f"{source}{where}: not valid YAML: {words}") from None


class _Refused(Exception):
    """What is wrong with an event of the parser."""


@dataclass
class _Open:
    """A section or list that the parser is in."""

    anchor: str | None
    keys: set[str] | None
    """None: a list"""
    at_key: bool = True
    values: int = 1


@dataclass
class _Count:
    """Values that stand behind each anchor; None while it is open."""

    open: list[_Open] = field(default_factory=list)
    behind: dict[str, int | None] = field(default_factory=dict)

    def take(self, event: Any) -> None:
        """Check an event, and count its values. Raises _Refused."""
        if isinstance(event, yaml.CollectionEndEvent):
            closed = self.open.pop()
            if closed.anchor is not None:
                self.behind[closed.anchor] = closed.values
            self._add(closed.values)
        if not isinstance(event, yaml.AliasEvent | yaml.ScalarEvent | yaml.CollectionStartEvent):
            return
        inner = self.open[-1] if self.open else None
        keys = None
        if inner is not None and inner.keys is not None:
            # of a key, what follows then is its value
            keys = inner.keys if inner.at_key else None
            inner.at_key = not inner.at_key
        if isinstance(event, yaml.AliasEvent):
            if keys is not None:
                raise _Refused("an alias as a key; write the key as text")
            if event.anchor in self.behind:
                behind = self.behind[event.anchor]
                if behind is None:
                    raise _Refused(f"alias '{event.anchor[:40]}' stands for a section that contains it")
                self._add(behind)
            return
        if event.tag not in (None, "!", f"{_CORE}str"):
            kind = event.tag.removeprefix(_CORE)[:40]
            raise _Refused(f"a type, '{kind}'; write the plain value alone")
        if event.anchor is not None:
            self.behind[event.anchor] = 1 if isinstance(event, yaml.ScalarEvent) else None
        if isinstance(event, yaml.ScalarEvent):
            self._check_scalar(event, keys)
            return
        if keys is not None:
            raise _Refused("a list or a section as a key; write the key as text")
        if len(self.open) >= MAX_DEPTH:
            raise _Refused(f"nested more than {MAX_DEPTH} deep")
        self.open.append(_Open(event.anchor, set() if isinstance(event, yaml.MappingStartEvent) else None))

    def _check_scalar(self, event: yaml.ScalarEvent, keys: set[str] | None) -> None:
        text = event.value
        if _CONTROL.search(text):
            raise _Refused("a control character; write it out, or remove it")
        is_number = event.tag is None and event.style in (None, "") and text[:1] in tuple("-+.0123456789")
        if is_number and len(text) > MAX_NUMBER_LENGTH:
            raise _Refused(f"a number of {len(text)} characters; give at most {MAX_NUMBER_LENGTH}")
        if keys is not None:
            if len(text) > MAX_KEY_LENGTH:
                raise _Refused(f"a key of {len(text)} characters; give at most {MAX_KEY_LENGTH}")
            if text in keys:
                raise _Refused(f"key '{text}' is given twice in one section; keep one of them")
            keys.add(text)
        self._add(1)

    def _add(self, values: int) -> None:
        """Count in the innermost section; all of them are counted when it closes."""
        if self.open:
            self.open[-1].values += values
            if self.open[-1].values > MAX_VALUES:
                raise _Refused(f"more than {MAX_VALUES} values, with those that aliases repeat")
