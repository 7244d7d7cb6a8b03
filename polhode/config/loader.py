"""Reading a configuration: YAML, ``extends``, overrides, and errors of one line each.

An error names the file (or the option) that set the value, the dotted key, and what is valid there.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from polhode.config import Config
from polhode.config import keys as config_keys
from polhode.files.yaml_files import read_yaml
from polhode.runtime.errors import InputError

Model = TypeVar("Model", bound=BaseModel)

EXTENDS = "extends"
MAX_FILES = 16
"""Of a chain of ``extends``"""
COMMAND_LINE = "command line"
_RANGES = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("at most", "le"),
}
_NAME = re.compile(r"[\w. -]{1,64}")


@dataclass
class _Layered:
    """Values merged so far, and the last source of each key."""

    values: dict[str, Any] = field(default_factory=dict)
    source: dict[config_keys.Path, str] = field(default_factory=dict)

    def merge(self, update: Mapping[str, Any], source: str) -> "_Layered":
        """Lay values over those of before."""

        def into(target: dict[str, Any], update: Mapping[str, Any], path: config_keys.Path) -> None:
            self.source[path] = source
            for key, value in update.items():
                if isinstance(value, dict):
                    base = target.get(key)
                    target[key] = dict(base) if isinstance(base, dict) else {}
                    into(target[key], value, (*path, key))
                else:
                    target[key] = value
                    self.source[(*path, key)] = source

        into(self.values, update, ())
        return self

    def source_of(self, path: Sequence[config_keys.Step]) -> str:
        """Source of the key or of the closest section above it."""
        above = (tuple(path[:length]) for length in range(len(path), -1, -1))
        return next((self.source[each] for each in above if each in self.source), "configuration")


def load_config(
    path: Path | None, overrides: Mapping[str, Any] | None = None, source: str = COMMAND_LINE
) -> Config:
    """Read ``path`` (None: the defaults) and what it extends, lay ``overrides`` (dotted key -> value) over.

    ``source``: where the overrides come from, for errors.

    Raises InputError: a missing file, a YAML syntax error with its line, a circular ``extends``, an
    unknown key, a wrong type, a value out of range.
    """
    layered = _Layered() if path is None else _of_files(path)
    for key, value in (overrides or {}).items():
        layered.merge(_nested(key.split("."), value), source)
    return _config_of(layered)


def load_stored_config(path: Path) -> Config:
    """The configuration that a run has stored; keys that this version has no more are left out.

    Raises InputError as ``load_config`` for all else.
    """
    layered, unknown = _of_files(path), list[config_keys.Path]()
    try:
        Config.model_validate(layered.values)
    except ValidationError as error:
        unknown = [tuple(each["loc"]) for each in error.errors() if each["type"] == "extra_forbidden"]
    for *sections, name in unknown:
        holder: Any = layered.values
        for each in sections:
            holder = holder[each]
        del holder[name]
    return _config_of(layered)


def read_settings(path: Path) -> dict[str, Any]:
    """What ``path`` and the files that it extends set, unchecked. Raises InputError."""
    return _of_files(path).values


def config_with(
    values: Mapping[str, Any], source: str, changes: Mapping[str, Any], source_of_changes: str
) -> Config:
    """The configuration of ``values`` (sections, as in a file) with ``changes`` (dotted key -> value).

    A number in a dotted key names an element of a list: "scene.motion.spin_rpm.1". Raises InputError as
    ``load_config``, with the source of what is wrong.
    """
    layered = _Layered().merge(values, source)
    for key, value in changes.items():
        layered.merge(_at(layered.values, key.split("."), value), source_of_changes)
    return _config_of(layered)


def validated(model: type[Model], values: Mapping[str, Any], source: str) -> Model:
    """A section that stands alone in a file, from its ``values``. Raises InputError as ``load_config``."""
    return _validate(_Layered().merge(values, source), model)


def plain_settings(config: BaseModel) -> dict[str, Any]:
    """All settings as sections, lists and plain values, as in a file."""
    plain = _plain(config.model_dump())
    assert isinstance(plain, dict)
    return plain


def dump_config(config: Config, keys: Collection[str] | None = None) -> str:
    """The resolved configuration as YAML, every default written out; ``load_config`` reads it back equal.

    ``keys``: only these of the top level.
    """
    header = "# Resolved configuration, every default written out.\n"
    plain = _plain(config.model_dump(include=None if keys is None else set(keys)))
    return header + yaml.dump(plain, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)


def _of_files(path: Path) -> _Layered:
    """A file laid over those that it extends, base first."""
    chain: list[Path] = []
    layers: list[dict[str, Any]] = []
    base: Any = path.name
    while base is not None:
        if chain:
            if not isinstance(base, str):
                got = _shown(base)
                raise InputError(f"{path}: '{EXTENDS}': expected the path of one file, got {got}")
            path = path.parent / base
        if path.resolve() in (other.resolve() for other in chain):
            circle = " -> ".join(str(each) for each in (*chain, path))
            raise InputError(f"{chain[0]}: '{EXTENDS}' is circular: {circle}")
        if len(chain) >= MAX_FILES:
            raise InputError(
                f"{chain[0]}: '{EXTENDS}' goes on over more than {MAX_FILES} files; join some of them"
            )
        named = f", which {chain[-1]} extends," if chain else ""
        loaded = read_yaml(path, f"{path}{named} is missing: give an existing configuration file")
        values = {} if loaded is None else loaded
        if not isinstance(values, dict):
            # A configuration of someone else may extend any file: what stands in it is not repeated.
            got = "something else" if chain else _shown(loaded)
            raise InputError(f"{path}{named}: expected keys such as 'frontend:' at the top, got {got}")
        base = values.pop(EXTENDS, None)
        chain.append(path)
        layers.append(values)
    layered = _Layered()
    for file, values in zip(reversed(chain), reversed(layers), strict=True):
        layered.merge(values, str(file))
    return layered


def _at(values: Any, path: Sequence[str], value: Any) -> dict[str, Any]:
    """The sections that set one value; an element of a list takes the list as it is with it."""
    for length in range(1, len(path)):
        values = values.get(path[length - 1]) if isinstance(values, dict) else None
        step, rest = path[length], path[length + 1 :]
        if isinstance(values, list) and step.isdecimal() and int(step) < len(values):
            changed, position = list(values), int(step)
            if rest:
                layered = _Layered().merge({"element": changed[position]}, "")
                layered.merge(_at(layered.values, ["element", *rest], value), "")
                value = layered.values["element"]
            changed[position] = value
            return _nested(path[:length], changed)
    return _nested(path, value)


def _nested(path: Sequence[str], value: Any) -> dict[str, Any]:
    for step in reversed(path):
        value = {step: value}
    assert isinstance(value, dict)
    return value


def _drop_empty_sections(values: dict[str, Any], path: config_keys.Path) -> None:
    """``backend:`` with nothing below it is null in YAML; here it is a section with its defaults."""
    for key, value in list(values.items()):
        options = config_keys.options_of(config_keys.annotation_at(Config, (*path, key)))
        if isinstance(value, dict):
            _drop_empty_sections(value, (*path, key))
        elif value is None and type(None) not in options and config_keys.section_at(Config, (*path, key)):
            del values[key]


def _config_of(layered: _Layered) -> Config:
    _drop_empty_sections(layered.values, ())
    return _validate(layered, Config)


def _validate(layered: _Layered, model: type[Model]) -> Model:
    try:
        valid = model.model_validate(layered.values)
    except ValidationError as error:
        problems = error.errors()
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(_one_line(model, layered, dict(problems[0])) + more) from None
    _refuse_booleans_as_numbers(model, layered, layered.values, valid, ())
    return valid


def _one_line(model: type[BaseModel], layered: _Layered, problem: dict[str, Any]) -> str:
    """One pydantic error as: file: key 'a.b': what is wrong; what is valid."""
    path = _path_in(layered.values, problem["loc"], problem["type"])
    source, key = layered.source_of(path), config_keys.dotted(path)
    if problem["type"] == "extra_forbidden":
        section = config_keys.section_at(model, path[:-1]) or model
        valid = [*section.model_fields, *([EXTENDS] if len(path) == 1 and model is Config else [])]
        if not _NAME.fullmatch(str(path[-1])):
            # It may be a line of any file: a configuration of someone else can extend /etc/shadow.
            return f"{source}: a key that is not a name; valid keys: {', '.join(valid)}"
        hint = config_keys.suggestion(str(path[-1]), valid) or config_keys.elsewhere(model, str(path[-1]))
        return f"{source}: unknown key '{key}';{hint} valid keys: {', '.join(valid)}"
    where = f"{source}: key '{key}'" if key else source
    if problem["type"] == "missing":
        return f"{where}: missing; {_expected(model, path)}"
    got = _shown(problem["input"])
    if problem["type"] == "value_error":
        return f"{where}: {problem['msg'].removeprefix('Value error, ')}"
    if problem["type"] in _RANGES:
        words, name = _RANGES[problem["type"]]
        return f"{where}: must be {words} {problem['ctx'][name]:g}, got {got}"
    if problem["type"] == "too_long":
        return f"{where}: more than {problem['ctx']['max_length']} values; give fewer"
    if problem["type"] == "literal_error":
        choices = _expected(model, path).removeprefix("expected one of ").split(", ")
        got = f"{got};{config_keys.suggestion(str(problem['input']), choices)}".rstrip(";")
    return f"{where}: {_expected(model, path)}, got {got}"


def _path_in(values: Any, location: Sequence[config_keys.Step], kind: str) -> config_keys.Path:
    """The part of pydantic's location that names a key of ours: it also names members of unions."""
    path: list[config_keys.Step] = []
    for position, step in enumerate(location):
        present = (isinstance(values, dict) and step in values) or (
            isinstance(values, list | tuple) and isinstance(step, int) and step < len(values)
        )
        if present:
            path.append(step)
            values = values[step]
        elif kind == "missing" and position == len(location) - 1:
            path.append(step)
    return tuple(path)


def _expected(model: type[BaseModel], path: config_keys.Path) -> str:
    """Description of the valid values at ``path``; an element of a list is described by its list."""
    steps = list(path)
    while steps and not isinstance(steps[-1], str):
        steps.pop()
    annotation = config_keys.annotation_at(model, steps)
    return f"expected {config_keys.describe(annotation)}" if annotation is not None else "not valid"


def _shown(value: Any) -> str:
    """A value of the user, short and on one line, with its type as named in YAML."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    kind = "section " if isinstance(value, dict) else "list " if isinstance(value, list) else ""
    kind = "text " if isinstance(value, str) else kind
    shown = " ".join(repr(value).split())
    return kind + (shown if len(shown) <= 60 else shown[:57] + "...")


def _refuse_booleans_as_numbers(
    model: type[BaseModel], layered: _Layered, raw: Any, valid: Any, path: config_keys.Path
) -> None:
    """Pydantic reads true as 1, but who writes true for a number has the wrong key."""
    if isinstance(raw, bool) and not isinstance(valid, bool):
        where = f"{layered.source_of(path)}: key '{config_keys.dotted(path)}'"
        raise InputError(f"{where}: {_expected(model, path)}, got {_shown(raw)}")
    if isinstance(raw, dict):
        for key, value in raw.items():
            inner = getattr(valid, key) if isinstance(valid, BaseModel) else valid[key]
            _refuse_booleans_as_numbers(model, layered, value, inner, (*path, key))
    elif isinstance(raw, list) and isinstance(valid, list | tuple):
        for index, (value, inner) in enumerate(zip(raw, valid, strict=True)):
            _refuse_booleans_as_numbers(model, layered, value, inner, (*path, index))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return str(value) if isinstance(value, Path) else value


class _Dumper(yaml.SafeDumper):
    """Sections as blocks, lists on one line."""


_Dumper.add_representer(
    list, lambda dumper, values: dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=True)
)
