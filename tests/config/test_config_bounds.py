"""Every number of the configuration has a range, and a value outside of it is one line that names the key."""

import math
import types
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from polhode.config import Config
from polhode.config.keys import section_of
from polhode.config.loader import load_config
from polhode.runtime.errors import InputError


@dataclass(frozen=True)
class Number:
    """A number that a setting holds, alone or in a list, with its range."""

    path: tuple[str, ...]
    kind: type
    least: float | None
    most: float | None
    around: tuple[int, ...]
    """Lengths of the lists around it, the outermost first"""

    def setting(self, value: float) -> dict[str, Any]:
        """A configuration with this value wherever the setting takes a number."""
        filled: Any = value
        for length in reversed(self.around):
            filled = [filled] * length
        for name in reversed(self.path):
            filled = {name: filled}
        assert isinstance(filled, dict)
        return filled


def numbers(section: type[BaseModel], path: tuple[str, ...] = ()) -> Iterator[Number]:
    for name, field in section.model_fields.items():
        inner = section_of(field.annotation)
        if inner is not None:
            yield from numbers(inner, (*path, name))
        else:
            yield from _in(field.annotation, list(field.metadata), (*path, name), ())


def _in(
    annotation: Any, limits: list[Any], path: tuple[str, ...], around: tuple[int, ...]
) -> Iterator[Number]:
    if get_origin(annotation) is Annotated:
        annotation, *more = get_args(annotation)
        for each in more:
            limits = [*limits, *(each.metadata if isinstance(each, FieldInfo) else [each])]
    for option in members(annotation):
        if get_origin(option) is Annotated:
            yield from _in(option, limits, path, around)
        elif option in (int, float):
            ends = {
                name: getattr(limit, name)
                for limit in limits
                for name in ("ge", "gt", "le", "lt")
                if hasattr(limit, name)
            }
            least, most = (ends.get(one, ends.get(other)) for one, other in (("ge", "gt"), ("le", "lt")))
            yield Number(path, option, least, most, around)
        elif get_origin(option) is tuple and section_of(get_args(option)[0]) is None:
            arguments = get_args(option)
            length = 1 if arguments[-1] is ... else len(arguments)
            yield from _in(arguments[0], [], path, (*around, length))
        elif get_origin(option) is dict:
            yield from _in(get_args(option)[1], [], path, around)
        elif get_origin(option) is tuple:
            yield from numbers(get_args(option)[0], (*path, "0"))
        else:
            assert option in (str, bool, type(None)) or get_origin(option) is Literal, option


def members(annotation: Any) -> tuple[Any, ...]:
    """Of a union; a single type is a union of one."""
    return get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)


NUMBERS = list(numbers(Config))
IN_FILES = [
    number for number in NUMBERS if "0" not in number.path and "part_density_kg_m3" not in number.path
]


def test_every_number_has_a_range() -> None:
    assert len(NUMBERS) > 150
    assert [".".join(each.path) for each in NUMBERS if each.least is None or each.most is None] == []


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bounds") / "c.yaml"


@pytest.mark.parametrize("number", IN_FILES, ids=lambda number: ".".join(number.path))
@settings(max_examples=3)
@given(data=st.data())
def test_a_value_outside_of_its_range_is_one_line(number: Number, file: Path, data: st.DataObject) -> None:
    assert number.least is not None and number.most is not None
    below: st.SearchStrategy[float] = st.floats(max_value=number.least, exclude_max=True)
    above: st.SearchStrategy[float] = st.floats(min_value=number.most, exclude_min=True)
    if number.kind is int:
        below = st.integers(max_value=int(number.least) - 1)
        above = st.integers(min_value=int(number.most) + 1)
    value = data.draw(below | above | st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308]))
    file.write_text(yaml.safe_dump(number.setting(value)))
    with pytest.raises(InputError) as error:
        load_config(file)
    message = str(error.value)
    assert message.isprintable() and len(message) < 500
    assert message.startswith(f"{file}: key '{'.'.join(number.path)}")


def test_the_ends_of_a_range_are_within_it(file: Path) -> None:
    """They may contradict another setting, or be excluded."""
    for number in IN_FILES:
        for value in (number.least, number.most):
            assert value is not None
            file.write_text(yaml.safe_dump(number.setting(int(value) if number.kind is int else value)))
            message = ""
            try:
                load_config(file)
            except InputError as error:
                message = str(error)
            assert "must be at" not in message, number


TOO_MUCH: dict[str, tuple[str, str]] = {
    "rows of the truth": ("{interval_s: 1.0e-6, truth_horizon_s: 60}", "make 6e+07 rows"),
    "three years": ("{frames: 100000, interval_s: 1.0e+6}", "exceed 1e+08 s"),
    "revolutions": ("{motion: {spin_rpm: [1000, 0, 0]}, truth_horizon_s: 1.0e+5}", "revolutions in all"),
    "pixels": ("{rig: {width_px: 8192, height_px: 8192}}", "more than 64 million"),
    "crossings": ("{inspector: {deadband_mm: 1.0e-6}}", "inspector.deadband_mm is crossed more than"),
}


def test_settings_that_are_too_much_together_are_refused(file: Path) -> None:
    for scene, message in TOO_MUCH.values():
        file.write_text(f"scene: {scene}")
        with pytest.raises(InputError, match=message.replace("+", r"\+")):
            load_config(file)
    file.write_text("compare: {monte_carlo: {frames: [10000], landmarks: [1000000]}}")
    with pytest.raises(InputError, match="10000 frames of 1000000 landmarks are more than 20000000"):
        load_config(file)
