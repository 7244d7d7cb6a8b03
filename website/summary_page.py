"""The page of a run's files and of every field of summary.json, from the models that write it."""

import re
from typing import Any

from polhode.pipeline.run_directory.summary_schema import Summary
from polhode.pipeline.run_directory.trajectory_file import TRAJECTORY_COLUMNS

Schema = dict[str, Any]


def summary_page() -> str:
    """Markdown."""
    schema = Summary.model_json_schema(mode="serialization")
    text = (
        "# summary.json and trajectory.csv\n\n"
        "Every field of a run's `summary.json`, made from the models that write and check it; "
        "[the run directory](../run_directory.md) describes the files in prose. Where a quantity is not "
        "determined, its variance is `null`.\n\n## summary.json\n\n" + _table(schema)
    )
    for name, part in sorted(schema.get("$defs", {}).items()):
        if "properties" in part:
            text += f"\n### {name}\n\n{_prose(part.get('description', ''))}\n\n{_table(part)}"
    columns = ", ".join(f"`{column}`" for column in TRAJECTORY_COLUMNS)
    return text + (
        f"\n## trajectory.csv\n\n{len(TRAJECTORY_COLUMNS)} columns, one row for every stereo pair: {columns}."
        " `trajectory_online.csv` has the same.\n"
    )


def _table(part: Schema) -> str:
    rows = "".join(
        f"| `{name}` | {_kind(value)} | {_prose(value.get('description', ''))} |\n"
        for name, value in part["properties"].items()
    )
    return "| field | type | meaning |\n|---|---|---|\n" + rows


def _kind(value: Schema) -> str:
    """Type of a field in words; the parts of the file are links."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_kind(each) for each in value["anyOf"]))
    if "enum" in value or "const" in value:
        return ", ".join(f"`{each}`" for each in value.get("enum", [value.get("const")]))
    if value.get("type") == "array":
        return _array(value)
    if value.get("type") == "object":
        inner = value.get("additionalProperties")
        return f"mapping to {_kind(inner)}" if isinstance(inner, dict) else "mapping"
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
    return names.get(value.get("type", ""), str(value.get("type", "any")))


def _array(value: Schema) -> str:
    if "prefixItems" in value:
        inner = " or ".join(dict.fromkeys(_kind(each) for each in value["prefixItems"]))
        return f"{len(value['prefixItems'])} × {inner}"
    return f"list of {_kind(value['items'])}" if "items" in value else "list"


def _prose(text: str) -> str:
    return re.sub(r"([\\<>*_\[\]|])", r"\\\1", " ".join(text.split()))
