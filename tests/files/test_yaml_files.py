"""YAML of others: plain values, text as keys, and a limit to everything that can grow."""

import math
from pathlib import Path
from typing import Any

import pytest

from polhode.files.foreign_files import CONFIGURATION_BYTES
from polhode.files.yaml_files import parse_yaml, read_yaml
from polhode.runtime.errors import InputError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("a: {b: [1, -2, 0x1F, 0b11, 1_000]}", {"a": {"b": [1, -2, 31, 3, 1000]}}),
        ("[1.5, 1e-8, 1e5, .5, 5., -1.5E+3]", [1.5, 1e-8, 1e5, 0.5, 5.0, -1.5e3]),
        ("[yes, no, true, OFF, ~, null, 'null']", [True, False, True, False, None, None, "null"]),
        ("[2024-01-01, 2024-99-99, 1:30, 1:30.5, 010, =, 1e, 1.2.3]", "as written"),
        ("{1: a, true: b, null: c, 2024-01-01: d}", {"1": "a", "true": "b", "null": "c", "2024-01-01": "d"}),
        ("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}", {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}}),
        ("a: !!str 1", {"a": "1"}),
        ("a: &a x\n*a : b", {"a": "x", "x": "b"}),
    ],
)
def test_plain_values(text: str, value: Any) -> None:
    if value == "as written":
        value = text.strip("[]").split(", ")
    assert parse_yaml(text, "here") == value


def test_infinity_and_nan_are_numbers_for_the_reader_to_judge() -> None:
    values = parse_yaml("[.inf, -.inf, .nan, 1e400]", "here")
    assert values[:2] == [math.inf, -math.inf] and math.isnan(values[2]) and values[3] == math.inf


def _tower(line: str, last: str) -> str:
    names = "abcdefghij"
    rows = [line.format(name=names[k], inner=names[k - 1]) for k in range(1, 10)]
    return "\n".join(["a: &a " + last, *rows])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_tower("{name}: &{name} [" + ", ".join(["*{inner}"] * 10) + "]", "[1, 2]"), "values"),
        (_tower("{name}: &{name} {{<<: [" + ", ".join(["*{inner}"] * 10) + "]}}", "{x: 1}"), "values"),
        ("- " * 300_000, "line 1: nested more than 32 deep"),
        ("\n".join(" " * k + "a:" for k in range(1000)), "line 33: nested more than 32 deep"),
        ("x: [" + "1," * 400_000 + "]", "more than 200000 values"),
        ("x: 0x" + "f" * 900_000, "a number of 900002 characters; give at most 64"),
        ("a: {b: 1, 'b': 2}", "line 1: key 'b' is given twice in one section"),
        ("? [a]\n: b", "line 1: a list or a section as a key"),
        ("a: *b", "line 1: not valid YAML: found undefined alias"),
        ("a: {<<: 3}", "not valid YAML: expected a mapping"),
        ('"\\e[2J"', "line 1: a control character"),
        ("!!float [1]", "line 1: a type, 'float'"),
        ("!!str [1]", "line 1: a type, 'str'"),
        ("%YAML:1.0\na: 1", "not valid YAML"),
    ],
    ids=lambda text: text[:12] if isinstance(text, str) else None,
)
def test_everything_that_can_grow_has_a_limit(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        parse_yaml(text, "here")
    assert str(error.value).startswith("here") and "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: 1 #".ljust(CONFIGURATION_BYTES, "x"))
    assert read_yaml(path) == {"a": 1}
    path.write_text("a: 1 #".ljust(CONFIGURATION_BYTES + 1, "x"))
    with pytest.raises(InputError, match="more than the 1 MB that a YAML file may have"):
        read_yaml(path)


def test_a_missing_file_has_the_message_of_the_caller(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^the camera lacks its calibration$"):
        read_yaml(tmp_path / "none", "the camera lacks its calibration")
    with pytest.raises(InputError, match="none is missing"):
        read_yaml(tmp_path / "none")
