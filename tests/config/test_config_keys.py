"""The tree of keys: every value is documented and can be written on a command line."""

from typing import Literal

import pytest
from pydantic import BaseModel

from polhode.config import Config
from polhode.config.keys import arrange, count_of, describe, dotted, leaves, section_at, section_of


def sections(section: type[BaseModel]) -> dict[str, type[BaseModel]]:
    paths = {path[:-1] for path, _ in leaves(section)}
    found = {dotted(path): section_at(section, path) for path in paths}
    return {name: each for name, each in found.items() if each is not None}


def test_every_section_is_closed_and_frozen_and_every_key_is_documented() -> None:
    for name, section in sections(Config).items():
        assert section.model_config.get("extra") == "forbid", name
        assert section.model_config.get("frozen") is True, name
        for key, field in section.model_fields.items():
            assert field.description or section_of(field.annotation) is not None, f"{name}.{key}"


@pytest.mark.parametrize(
    ("annotation", "count"),
    [
        (float, 1),
        (float | None, 1),
        (tuple[float, float, float], 3),
        (tuple[tuple[float, float], tuple[float, float]] | None, 4),
        (tuple[int, ...], None),
        (list[str], None),
        (Literal["a", "b"], 1),
    ],
)
def test_words_that_a_value_takes(annotation: object, count: int | None) -> None:
    assert count_of(annotation) == count


def test_words_are_nested_as_the_type_says() -> None:
    nested = tuple[tuple[float, float], tuple[float, float]] | None
    assert arrange(nested, ["1", "2", "3", "4"]) == [["1", "2"], ["3", "4"]]
    assert arrange(float, ["1"]) == "1"
    assert arrange(tuple[int, ...], ["1"]) == ["1"]
    pairs = tuple[tuple[float, float], ...]
    assert arrange(pairs, ["1", "2", "3", "4"]) == [["1", "2"], ["3", "4"]]
    # an odd one out is left for pydantic to name
    assert arrange(pairs, ["1", "2", "3"]) == ["1", "2", "3"]
    assert arrange(Literal[1, 4], ["4"]) == 4


def test_types_are_described_in_words() -> None:
    assert describe(float | None) == "a number or null"
    assert describe(Literal["a", "b"]) == "one of a, b"
    assert describe(tuple[float, float]) == "a list of 2, each a number"
