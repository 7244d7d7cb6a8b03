"""The pages of the reference, as Markdown, from the types and docstrings that the program itself uses."""

import contextlib
import io
import os
import re
from collections.abc import Iterable, Iterator
from typing import Any, get_args, get_origin
from unittest.mock import patch

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from docs.website.source_pages import site_path
from lab.registry import BENCHMARKS, Benchmark
from polhode.cli.main import COMMANDS, main
from polhode.cli.options import ConfiguredCommand
from polhode.config import Config
from polhode.config.keys import describe, options_of, section_of
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import TRAJECTORY_COLUMNS

HELP_COLUMNS = 96
LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
"""Keywords of JSON Schema, and their signs"""
Schema = dict[str, Any]

API = """# Python API

[From Python](../api.md) shows how it is used; this page lists what there is, by the docstrings.

::: polhode.api.run
::: polhode.api.load
::: polhode.api.load_study
::: polhode.api.simulate
::: polhode.api.evaluate
::: polhode.api.configuration
::: polhode.api.Run
::: polhode.api.MassEstimate
::: polhode.pipeline.live.session.Session
::: polhode.records
::: polhode.runtime.errors
"""


def table(head: str, rows: Iterable[Iterable[str]]) -> str:
    """A table of Markdown; head: the titles with bars between them."""
    lines = [head, "|".join("---" for _ in head.split("|"))]
    lines += [" | ".join(cell.replace("|", "\\|") for cell in row) for row in rows]
    return "".join(f"| {line} |\n" for line in lines) + "\n"


def prose(text: str) -> str:
    """A docstring on one line, with what Markdown would take for markup escaped."""
    return re.sub(r"([\\<>*_\[\]])", r"\\\1", " ".join(text.split()))


def commands_page() -> str:
    """The help of every command."""
    text = "# Commands\n\nWhat `polhode COMMAND -h` prints.\n\n"
    first = (" ".join((command.__doc__ or "").split()).partition(". ")[0] for command in COMMANDS.values())
    names = (f"[`polhode {name}`](#{name})" for name in COMMANDS)
    text += table("command | what it does", zip(names, first, strict=True))
    for name, command in COMMANDS.items():
        printed = help_of(name)
        if issubclass(command, ConfiguredCommand):
            printed += "\n\nEvery setting of the configuration is an option, too."
        text += f"## {name}\n\n```text\n{printed}\n```\n\n"
    return text


def help_of(command: str) -> str:
    """The help of a command in HELP_COLUMNS, as it is printed where standard output is no terminal."""
    printed = io.StringIO()
    with patch.dict(os.environ, {"COLUMNS": str(HELP_COLUMNS)}), contextlib.redirect_stdout(printed):
        main([command, "-h"])
    return "\n".join(line.rstrip() for line in printed.getvalue().rstrip().splitlines())


def settings_page() -> str:
    """Every setting with its type, range, default and text."""
    text = (
        "# Settings\n\nEvery key of a [configuration](../command_line.md#configuration). A key "
        "`backend.inertia` is the option `--backend.inertia`; a range is that of every number of the value, "
        "and the unit is the suffix of the key or stands in brackets.\n\n"
    )
    for prefix, section in sections(Config):
        schema = section.model_json_schema()["properties"]
        rows = [
            (f"`{name}`", _type(field), _range(schema[name]), _default(field), prose(field.description or ""))
            for name, field in section.model_fields.items()
            if section_of(field.annotation) is None
        ]
        if rows:
            text += f"## {prefix or 'top level'}\n\n{prose(section.__doc__ or '')}\n\n"
            text += table("key | type | range | default | meaning", rows)
    return text


def sections(root: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Every section with its dotted path; ``[]`` stands for an entry of a list, ``.NAME`` of a mapping."""
    yield prefix, root
    for name, field in root.model_fields.items():
        path = f"{prefix}.{name}" if prefix else name
        inner = section_of(field.annotation)
        if inner is not None:
            yield from sections(inner, path)
        for option in options_of(field.annotation):
            if get_origin(option) in (tuple, list, dict):
                entry = section_of(get_args(option)[-2 if get_origin(option) is tuple else -1])
                if entry is not None:
                    yield from sections(entry, path + (".NAME" if get_origin(option) is dict else "[]"))


def _type(field: FieldInfo) -> str:
    return re.sub(r"a section with keys .*", "a section, see below", describe(field.annotation))


def _range(schema: Any) -> str:
    """Limits of the numbers, wherever in a schema they stand."""
    if isinstance(schema, list):
        return next(filter(None, map(_range, schema)), "")
    if not isinstance(schema, dict):
        return ""
    own = ", ".join(f"{sign} {schema[word]:g}" for word, sign in LIMITS.items() if word in schema)
    return own or _range([value for key, value in schema.items() if key != "default"])


def _default(field: FieldInfo) -> str:
    value = field.get_default(call_default_factory=True)
    if field.is_required() or value is PydanticUndefined:
        return "required"
    if isinstance(value, BaseModel):
        return "see below"
    if isinstance(value, tuple | list) and value and isinstance(value[0], BaseModel):
        return f"{len(value)} entries"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def summary_page() -> str:
    """Every field of summary.json, from the models that write and check it; columns of trajectory.csv."""
    schema = Summary.model_json_schema(mode="serialization")
    text = (
        "# summary.json and trajectory.csv\n\n[The run directory](../run_directory.md) describes the files. "
        "Where a quantity is not determined, its variance is `null`.\n\n## summary.json\n\n"
    ) + _fields(schema)
    for name, part in sorted(schema.get("$defs", {}).items()):
        if "properties" in part:
            text += f"### {name}\n\n{prose(part.get('description', ''))}\n\n{_fields(part)}"
    columns = ", ".join(f"`{column}`" for column in TRAJECTORY_COLUMNS)
    return text + f"## trajectory.csv\n\n{len(TRAJECTORY_COLUMNS)} columns: {columns}.\n"


def _fields(part: Schema) -> str:
    rows = (
        (f"`{name}`", _kind(value), prose(value.get("description", "")))
        for name, value in part["properties"].items()
    )
    return table("field | type | meaning", rows)


def _kind(value: Schema) -> str:
    """Type of a field in words; the parts of the file are links."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(map(_kind, value["anyOf"])))
    if "enum" in value or "const" in value:
        return ", ".join(f"`{each}`" for each in value.get("enum", [value.get("const")]))
    if "prefixItems" in value:
        inner = " or ".join(dict.fromkeys(map(_kind, value["prefixItems"])))
        return f"{len(value['prefixItems'])} × {inner}"
    entry = value.get("items", value.get("additionalProperties"))
    return str(value.get("type", "any")) + (f" of {_kind(entry)}" if isinstance(entry, dict) else "")


def benchmarks_page() -> str:
    """Every benchmark with its command and the page that quotes it."""
    text = (
        "# Benchmarks\n\nEvery figure of these pages that was measured has a command that prints it. "
        "*Minutes* are those of one core, roughly. `python -m lab NAME` runs one, `make bench` all, "
        "and `--short` a small version, which shows that the command works.\n\n"
    )
    for topic in dict.fromkeys(each.topic for each in BENCHMARKS):
        rows = (_benchmark_row(each) for each in BENCHMARKS if each.topic == topic)
        text += f"## {topic}\n\n" + table("name | what it prints | command | minutes | page", rows)
    return text


def _benchmark_row(benchmark: Benchmark) -> tuple[str, ...]:
    command = " ".join(["python -m", f"lab.{benchmark.module}", *benchmark.full.split()])
    page = benchmark.page
    name = page.removesuffix("/README.md").removesuffix(".md").rpartition("/")[2]
    link = f"[{name}](../{site_path(page)})" if page else "-"
    return f"`{benchmark.name}`", benchmark.prints, f"`{command}`", f"{benchmark.minutes:g}", link
