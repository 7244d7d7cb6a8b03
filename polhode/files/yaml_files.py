"""Reading YAML that others wrote: configurations, calibrations, values on the command line.

Events of the parser, and then nodes, are counted before anything is made of them, so that a file of one
kilobyte whose aliases stand for a billion values, or one nested a million deep, is refused at once. Of
YAML's types, those that no file of ours has are text: dates, numbers in base 60. Keys are text, and a key
that stands twice in a section is an error.
"""

import re
from pathlib import Path
from typing import Any, NoReturn

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
TOO_MANY = f"more than {MAX_VALUES} values, with those that aliases repeat"

_CORE = "tag:yaml.org,2002:"
_KINDS: dict[type, tuple[str, ...]] = {
    yaml.ScalarNode: ("str", "bool", "null", "merge", "int", "float"),
    yaml.SequenceNode: ("seq",),
    yaml.MappingNode: ("map",),
}
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
    # OpenCV's version of YAML, which some write above a sensor.yaml
    return parse_yaml(re.sub(r"\A\ufeff?%YAML:1\.0\s*(---)?", "", text), str(path))


def parse_yaml(text: str, source: str) -> Any:
    """What the YAML ``text`` says: None, text, numbers, booleans, lists, and mappings with text as keys.

    Raises InputError, one line that begins with ``source`` and the line, for what is not valid, is larger or
    nested deeper than any file of ours, repeats a key, or has a type that none has.
    """
    depth, values, loader = 0, 0, _Loader(text)
    event: Any
    try:
        for event in yaml.parse(text, Loader=_Loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            values += isinstance(event, yaml.NodeEvent)
            if depth > MAX_DEPTH or values > MAX_VALUES:
                wrong = f"nested more than {MAX_DEPTH} deep" if depth > MAX_DEPTH else TOO_MANY
                raise InputError(f"{source} line {event.start_mark.line + 1}: {wrong}")
        document = loader.get_single_node()
        if document is None:
            return None
        _require_plain(document, source, {})
        return loader.construct_document(document)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "syntax error"
        words = " ".join(problem.split())[:200]
        raise InputError(f"{source}{where}: not valid YAML: {words}") from None
    finally:
        loader.dispose()


def _require_plain(node: yaml.Node, source: str, known: dict[int, int | None]) -> int:
    """The values of a node, those behind aliases counted wherever they stand; of a node that is open, None is
    ``known``. Raises InputError."""

    def refuse(wrong: str) -> NoReturn:
        raise InputError(f"{source} line {node.start_mark.line + 1}: {wrong}")

    if id(node) in known:
        values = known[id(node)]
        if values is None:
            refuse("an alias stands for a section that contains it")
        return values
    known[id(node)] = None
    kind, values = node.tag.removeprefix(_CORE), 1
    if kind not in _KINDS[type(node)]:
        refuse(f"a type, '{kind[:40]}'; write the plain value alone")
    if isinstance(node, yaml.ScalarNode):
        if _CONTROL.search(node.value):
            refuse("a control character; write it out, or remove it")
        is_number = node.style in (None, "") and node.value[:1] in tuple("-+.0123456789")
        if is_number and len(node.value) > MAX_NUMBER_LENGTH:
            refuse(f"a number of {len(node.value)} characters; give at most {MAX_NUMBER_LENGTH}")
    elif isinstance(node, yaml.SequenceNode):
        values += sum(_require_plain(each, source, known) for each in node.value)
    elif isinstance(node, yaml.MappingNode):
        keys: set[str] = set()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                refuse("a list or a section as a key; write the key as text")
            if len(key.value) > MAX_KEY_LENGTH:
                refuse(f"a key of {len(key.value)} characters; give at most {MAX_KEY_LENGTH}")
            if key.value in keys:
                node = key
                refuse(f"key '{key.value}' is given twice in one section; keep one of them")
            keys.add(key.value)
            values += _require_plain(key, source, known) + _require_plain(value, source, known)
    if values > MAX_VALUES:
        refuse(TOO_MANY)
    known[id(node)] = values
    return values
