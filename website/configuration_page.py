"""The page of the configuration: every setting, from the types that are the only source of defaults."""

import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from polhode.config import Config
from polhode.config.keys import describe, options_of, section_of

SUFFIXES = {
    "m": "m", "mm": "mm", "px": "px", "s": "s", "deg": "deg", "rpm": "RPM", "kg": "kg", "kg_m2": "kg m²",
    "kg_m3": "kg/m³", "hz": "Hz", "m_s": "m/s", "mm_s": "mm/s", "deg_s": "deg/s", "n": "N", "n_m": "N m",
    "bits": "bit", "um": "µm", "g": "grey levels",
}  # fmt: skip
"""Units by the suffix of a key"""
_MARKS: tuple[tuple[type, str, str], ...] = (
    (Ge, "≥", "ge"),
    (Gt, ">", "gt"),
    (Le, "≤", "le"),
    (Lt, "<", "lt"),
)


def configuration_page() -> str:
    """Markdown."""
    text = (
        "# Settings\n\n"
        "Every key of a configuration, made from the types that check it: they are the only source of "
        "defaults. [Configuration](../command_line.md#configuration) says how files, `extends` and the command line work "
        "together. A key `backend.inertia` is the option `--backend.inertia` of `polhode run`; a range is "
        "that of every number of the value.\n"
    )
    for prefix, section in sections(Config):
        fields = {name: field for name, field in section.model_fields.items() if _is_value(field)}
        if not fields:
            continue
        text += f"\n## {prefix or 'top level'}\n\n{_prose(section.__doc__ or '')}\n\n"
        text += "| key | type | unit | range | default | meaning |\n|---|---|---|---|---|---|\n"
        text += "".join(_row(name, field) for name, field in fields.items())
    return text


def sections(root: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Every section with its dotted path; ``[]`` stands for an entry of a list."""
    yield prefix, root
    for name, field in root.model_fields.items():
        path = f"{prefix}.{name}" if prefix else name
        inner = section_of(field.annotation)
        if inner is not None:
            yield from sections(inner, path)
        for entry, mark in _entries(field.annotation):
            yield from sections(entry, f"{path}{mark}")


def _entries(annotation: Any) -> Iterator[tuple[type[BaseModel], str]]:
    """Sections that stand in a list or a mapping."""
    for option in options_of(annotation):
        if get_origin(option) in (tuple, list, dict):
            inner = section_of(get_args(option)[-2 if get_origin(option) is tuple else -1])
            if inner is not None:
                yield inner, ".NAME" if get_origin(option) is dict else "[]"


def _is_value(field: FieldInfo) -> bool:
    return section_of(field.annotation) is None


def _row(name: str, field: FieldInfo) -> str:
    cells = (
        f"`{name}`",
        _type(field),
        _unit(name, field),
        _range(field),
        _default(field),
        _prose(field.description or ""),
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _type(field: FieldInfo) -> str:
    text = describe(field.annotation)
    return re.sub(r"a section with keys .*", "a section, see below", text)


def _unit(name: str, field: FieldInfo) -> str:
    """By the suffix of the key, or the square brackets of its text."""
    in_text = re.search(r"\[([^\]]*[a-zA-Z][^\]]*)\]", field.description or "")
    parts = name.lower().split("_")
    endings = ("_".join(parts[start:]) for start in range(1, len(parts)))
    by_suffix = next((SUFFIXES[ending] for ending in endings if ending in SUFFIXES), "")
    return by_suffix or (in_text[1] if in_text else "")


def _range(field: FieldInfo) -> str:
    """Limits of the numbers, wherever in the type they stand."""
    limits = dict(_limits(field.metadata))
    for option in options_of(field.annotation):
        limits = {**dict(_nested_limits(option)), **limits}
    return ", ".join(f"{mark} {limits[mark]:g}" for _, mark, _ in _MARKS if mark in limits)


def _limits(metadata: Any) -> Iterator[tuple[str, float]]:
    for each in metadata:
        for kind, mark, attribute in _MARKS:
            if isinstance(each, kind):
                yield mark, float(getattr(each, attribute))
        if isinstance(each, FieldInfo):
            yield from _limits(each.metadata)


def _nested_limits(annotation: Any) -> Iterator[tuple[str, float]]:
    if hasattr(annotation, "__metadata__"):
        yield from _limits(annotation.__metadata__)
    for argument in get_args(annotation):
        if not isinstance(argument, str | int | float):
            yield from _nested_limits(argument)


def _default(field: FieldInfo) -> str:
    value = field.get_default(call_default_factory=True) if not field.is_required() else PydanticUndefined
    if value is PydanticUndefined:
        return "required"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, BaseModel):
        return "see below"
    if isinstance(value, tuple | list) and value and isinstance(value[0], BaseModel):
        return f"{len(value)} entries"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def _prose(text: str) -> str:
    """A docstring on one line, with what Markdown would take for markup escaped."""
    line = " ".join(text.split())
    return re.sub(r"([\\<>*_\[\]])", r"\\\1", line)
