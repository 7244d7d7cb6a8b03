"""Records survive a file bit for bit; a file that is not as it was written is no record."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import BaseModel
from typing_extensions import TypeAliasType

from polhode.files.record_files import UnfitRecord, digest_of, normal, pack, read_record, unpack, write_record

KEY = "stage 0123"


class Model(BaseModel):
    low: float | None
    words: tuple[str, ...]


@dataclass(frozen=True)
class Inner:
    values: NDArray[np.float64]
    flags: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Outer:
    name: str
    number: int
    share: float
    yes: bool
    many: tuple[Inner, ...]
    pair: tuple[int, float]
    found: dict[str, float]
    masks: dict[int, tuple[bytes, bytes]]
    model: Model
    pixels: NDArray[np.uint8]


def example() -> Outer:
    rng = np.random.default_rng(1)
    inner = Inner(rng.normal(size=(3, 4)), rng.random(5) > 0.5)
    return Outer(
        *("a name", -3, float("nan"), True),
        many=(inner, Inner(np.array([np.inf, -0.0, np.nan]))),
        pair=(1, 0.1),
        found={"b": 2.0, "a": float("-inf")},
        masks={7: (b"left", b"")},
        model=Model(low=None, words=("x", "y")),
        pixels=np.arange(12, dtype=np.uint8).reshape(3, 4)[:, ::2],
    )


def test_a_record_is_the_same_bit_for_bit_after_a_file(tmp_path: Path) -> None:
    value = example()
    write_record(tmp_path / "r.npz", KEY, value)
    found = read_record(tmp_path / "r.npz", KEY, Outer)
    assert found is not None and digest_of(found) == digest_of(value)
    assert isinstance(found.many, tuple) and list(found.found) == ["b", "a"]
    assert found.many[1].flags is None and found.masks == {7: (b"left", b"")}
    assert found.pixels.flags.c_contiguous and found.pixels.flags.writeable
    write_record(tmp_path / "again.npz", KEY, example())
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "r.npz").read_bytes()


Scalar = TypeVar("Scalar", bound=np.generic)
ArrayOf = TypeAliasType("ArrayOf", np.ndarray[Any, np.dtype[Scalar]], type_params=(Scalar,))


@dataclass(frozen=True)
class Aliased:
    """As of NumPy 2.5, whose NDArray is an alias by PEP 695."""

    values: ArrayOf[np.float64]
    maybe: ArrayOf[np.float64] | None = None


def test_arrays_may_be_annotated_by_an_alias(tmp_path: Path) -> None:
    write_record(tmp_path / "r.npz", KEY, Aliased(np.arange(3.0), np.ones(2)))
    found = read_record(tmp_path / "r.npz", KEY, Aliased)
    assert found is not None and found.maybe is not None
    assert found.values.tolist() == [0.0, 1.0, 2.0] and found.maybe.tolist() == [1.0, 1.0]


def test_what_is_passed_on_has_the_layout_of_what_is_read_and_a_mesh_its_colours() -> None:
    given = Inner(np.asfortranarray(np.arange(6.0).reshape(2, 3)))
    assert not given.values.flags.c_contiguous
    assert normal(Inner, given).values.flags.c_contiguous
    np.testing.assert_array_equal(normal(Inner, given).values, given.values)
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh.visual.vertex_colors = np.arange(32, dtype=np.uint8).reshape(8, 4)
    found = normal(trimesh.Trimesh, mesh)
    assert digest_of(found) == digest_of(mesh)
    np.testing.assert_array_equal(found.visual.vertex_colors, mesh.visual.vertex_colors)


@given(st.lists(st.floats(width=64)), st.lists(st.integers(-(2**62), 2**62)))
def test_any_numbers_survive(floats: list[float], ints: list[int]) -> None:
    found = normal(tuple[list[float], list[int]], (floats, ints))
    assert digest_of(found) == digest_of((floats, ints))


@pytest.mark.parametrize("position", [0.01, 0.3, 0.6, 0.99])
def test_a_damaged_or_shortened_file_is_no_record(position: float, tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    write_record(path, KEY, Inner(np.random.default_rng(2).normal(size=300)))
    content = path.read_bytes()
    at = int(position * len(content))
    path.write_bytes(content[:at] + bytes([content[at] ^ 0x5A]) + content[at + 1 :])
    found = read_record(path, KEY, Inner)
    # some bytes of a zip archive say nothing, such as the time of a member
    assert found is None or digest_of(found) == digest_of(Inner(np.random.default_rng(2).normal(size=300)))
    path.write_bytes(content[:at])
    assert read_record(path, KEY, Inner) is None


def test_a_record_of_another_key_type_or_content_is_none(tmp_path: Path) -> None:
    path, other = tmp_path / "r.npz", tmp_path / "other.npz"
    write_record(path, KEY, Inner(np.ones(4)))
    with np.load(path) as stored:
        np.savez(other, **{**stored, "float64": np.zeros(4)})
    assert read_record(path, KEY, Inner) is not None
    assert read_record(other, KEY, Inner) is None
    assert read_record(path, "stage 4567", Inner) is None
    assert read_record(path, KEY, Outer) is None
    assert read_record(tmp_path / "missing.npz", KEY, Inner) is None


def test_digests_tell_values_types_and_order_apart() -> None:
    value = example()
    others = [
        replace(value, number=-4),
        replace(value, found={"a": float("-inf"), "b": 2.0}),
        replace(value, many=value.many[:1]),
        replace(value, pixels=value.pixels.T),
        replace(value, model=Model(low=0.0, words=("x", "y"))),
    ]
    assert len({digest_of(each) for each in (value, *others)}) == 1 + len(others)
    assert digest_of(1) != digest_of(1.0) != digest_of("1")
    assert digest_of(["ab", "c"]) != digest_of(["a", "bc"])
    assert digest_of(np.zeros(2)) != digest_of(np.zeros(2, dtype=np.float32))


def test_what_is_no_record_is_refused() -> None:
    with pytest.raises(UnfitRecord, match="function"):
        pack(lambda: 0)
    with pytest.raises(UnfitRecord, match="object"):
        pack(np.array([None]))
    with pytest.raises(UnfitRecord, match="function"):
        digest_of(lambda: 0)
    with pytest.raises(UnfitRecord):
        unpack(int, pack("text"))
