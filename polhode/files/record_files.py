"""Records of any shape as arrays in one file, and digests of what they hold.

A record is a dataclass, a pydantic model, a mesh, an array, a number, a text, or a tuple, list or mapping of
these. What it holds is written without its types: whoever reads it states the type, and a file that does not
fit it is refused. Nothing is unpickled.

A file is an archive of arrays: the elements of all arrays of the record, one after the other for each dtype;
``tree``, JSON, which says what is where; and the SHA-256 of all this together with a key, so that a file that
is cut short, damaged, or of another key is recognized.
"""

import dataclasses
import hashlib
import json
import types
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import BaseModel

from polhode.files.array_files import read_arrays
from polhode.files.atomic import replaced
from polhode.runtime.errors import InputError

T = TypeVar("T")
Arrays = dict[str, NDArray[Any]]

_TREE, _CHECKSUM = "tree", "sha256"


class UnfitRecord(Exception):
    """A value that is no record, or arrays that are not those of a record of the stated type."""


def pack(value: object) -> Arrays:
    """The record as arrays, one for each dtype and ``tree``. Raises UnfitRecord."""
    parts: dict[str, list[NDArray[Any]]] = {}
    filled: dict[str, int] = {}

    def tree(value: object) -> object:
        """What JSON can hold of a value; an array as where it is: dtype, first element, shape."""
        held = _held(value)
        if isinstance(held, np.ndarray):
            name = held.dtype.newbyteorder("=").name
            start = filled.get(name, 0)
            filled[name] = start + held.size
            parts.setdefault(name, []).append(np.ascontiguousarray(held).reshape(-1))
            return [name, start, list(held.shape)]
        if isinstance(held, dict):
            return {name: tree(part) for name, part in held.items()}
        return [tree(part) for part in held] if isinstance(held, list) else held

    text: NDArray[np.uint8] = np.frombuffer(json.dumps(tree(value)).encode(), dtype=np.uint8)
    return {**{name: np.concatenate(some) for name, some in sorted(parts.items())}, _TREE: text}


def _held(value: object) -> Any:
    """What a value holds, one level of it: None, a boolean, number, text or array; a list of parts; or parts
    by name, as a dict. Raises UnfitRecord."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise UnfitRecord(f"an array of {value.dtype} is no part of a record")
        return value
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=np.uint8)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, trimesh.Trimesh):
        colours = value.visual.vertex_colors  # type: ignore[union-attr]
        return [np.asarray(part) for part in (value.vertices, value.faces, colours)]
    if isinstance(value, BaseModel):
        return {name: getattr(value, name) for name in type(value).model_fields}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {each.name: getattr(value, each.name) for each in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return [list(each) for each in value.items()]
    if isinstance(value, Sequence):
        return list(value)
    raise UnfitRecord(f"{type(value).__name__} is no part of a record")


def unpack(kind: type[T], arrays: Mapping[str, NDArray[Any]]) -> T:
    """The record of a type from its arrays, which are copied. Raises UnfitRecord."""
    try:
        tree = json.loads(arrays[_TREE].tobytes())
        value = _value(kind, tree, arrays)
    except UnfitRecord:
        raise
    except Exception as error:
        raise UnfitRecord(f"not a {kind}: {error}") from error
    return value  # type: ignore[no-any-return]


def normal(kind: type[T], value: T) -> T:
    """The record as if it had been written and read.

    The layout of an array in memory can decide the last digit of what is computed from it: who goes on with
    this value gets the same digits as who goes on with the file.
    """
    return unpack(kind, pack(value))


def write_record(path: Path, key: str, value: object) -> None:
    """Write a record, whole or not at all. Raises UnfitRecord; RunFailure when it cannot be written."""
    arrays = pack(value)
    checksum: NDArray[np.uint8] = np.frombuffer(_checksum(key, arrays), dtype=np.uint8)
    with replaced(path) as partial, partial.open("wb") as stream:
        np.savez(stream, **{**arrays, _CHECKSUM: checksum})  # type: ignore[arg-type]


def read_record(path: Path, key: str, kind: type[T]) -> T | None:
    """The record that was written with this key; None: no such file, or it is not as it was written."""
    try:
        arrays = read_arrays(path)
        checksum = arrays.pop(_CHECKSUM).tobytes()
        return unpack(kind, arrays) if checksum == _checksum(key, arrays) else None
    except (InputError, KeyError, UnfitRecord):
        return None


def digest_of(*values: object) -> str:
    """SHA-256, hexadecimal, of what the values hold, with their types, and nothing of where they came from.

    A value of any class may state what it holds itself, as ``content_digest``. Raises UnfitRecord for one
    that is no record and states nothing.
    """
    digest = hashlib.sha256()

    def add(value: object) -> None:
        stated = getattr(value, "content_digest", None)
        if stated is not None:
            digest.update(f"digest {type(value).__qualname__} {stated};".encode())
            return
        held = _held(value)
        if isinstance(held, np.ndarray):
            kind = "bytes" if isinstance(value, bytes) else "array"
            digest.update(f"{kind} {held.dtype.str} {held.shape};".encode())
            digest.update(np.ascontiguousarray(held).data.cast("B") if held.size else b"")
        elif isinstance(held, dict):
            digest.update(f"{type(value).__qualname__} {list(held)};".encode())
            for part in held.values():
                add(part)
        elif isinstance(held, list):
            kind = "mapping" if isinstance(value, Mapping) else "sequence"
            digest.update(f"{kind} {len(held)};".encode())
            for part in held:
                add(part)
        else:
            text = f"{type(held).__name__} {held!r};"
            digest.update(text.encode(errors="surrogatepass"))

    add(values)
    return digest.hexdigest()


def _checksum(key: str, arrays: Mapping[str, NDArray[Any]]) -> bytes:
    digest = hashlib.sha256(key.encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape} ".encode())
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.digest()


def _value(kind: Any, tree: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """The value of a type, which annotations state, from its tree."""
    # NumPy 2.5 has NDArray as an alias (PEP 695), which stands for its type without being it.
    while (meant := getattr(kind, "__value__", None)) is not None:
        kind = meant
    origin, inner = get_origin(kind) or kind, get_args(kind)
    if origin in (Union, types.UnionType):
        if tree is None and type(None) in inner:
            return None
        for each in inner:
            with suppress(UnfitRecord, TypeError, ValueError, KeyError):
                return _value(each, tree, arrays)
        raise UnfitRecord(f"none of {inner}")
    if origin is Literal or kind is Any or kind is object:
        return tree
    if kind is type(None):
        _require(tree is None, kind)
        return None
    if origin is np.ndarray:
        return _array_of(tree, arrays)
    if kind is bytes:
        return _array_of(tree, arrays).tobytes()
    if kind in (bool, int, str):
        _require(type(tree) is kind, kind)
        return tree
    if kind is float:
        _require(isinstance(tree, float | int) and not isinstance(tree, bool), kind)
        return float(tree)
    if kind is Path:
        return Path(tree)
    if kind is trimesh.Trimesh:
        vertices, faces, colours = (_array_of(part, arrays) for part in tree)
        return trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)
    is_model = isinstance(kind, type) and issubclass(kind, BaseModel)
    if is_model or (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        hints = get_type_hints(kind)
        names = kind.model_fields if is_model else (each.name for each in dataclasses.fields(kind))
        _require(set(tree) == set(names), kind)
        parts = {name: _value(hints[name], part, arrays) for name, part in tree.items()}
        return kind.model_validate(parts) if is_model else kind(**parts)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {_value(inner[0], key, arrays): _value(inner[1], each, arrays) for key, each in tree}
    if origin is tuple and not (len(inner) == 2 and inner[1] is ...):
        return tuple(_value(each, part, arrays) for each, part in zip(inner, tree, strict=True))
    if isinstance(origin, type) and issubclass(origin, Sequence | Iterable):
        found = [_value(inner[0], part, arrays) for part in tree]
        return tuple(found) if origin is tuple else found
    raise UnfitRecord(f"{kind} is no type of a record")


def _array_of(place: Any, arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    name, start, shape = place
    size = int(np.prod(shape, dtype=np.int64))
    found = arrays[name][start : start + size]
    _require(found.size == size, np.ndarray)
    return found.reshape(shape).copy()


def _require(fits: bool, kind: Any) -> None:
    if not fits:
        raise UnfitRecord(f"not a {kind}")
