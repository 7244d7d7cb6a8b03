"""Archives of arrays: what they state is checked against what they hold, before anything is allocated."""

import io
import struct
import tracemalloc
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from polhode.files import array_files
from polhode.files.array_files import read_arrays, require_arrays
from polhode.runtime.errors import InputError


def _member(header: str | bytes, body: bytes = b"", version: bytes = b"\1\0") -> bytes:
    """An .npy file with any header."""
    text = header.encode() if isinstance(header, str) else header
    return b"\x93NUMPY" + version + struct.pack("<H", len(text)) + text + body


def _numbers(shape: str, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}\n"


def _archive(path: Path, *members: tuple[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return path


def _refusal(path: Path) -> str:
    with pytest.raises(InputError) as error:
        read_arrays(path)
    message = str(error.value)
    assert message.startswith(f"{path}") and message.isprintable() and len(message) < 400 + len(str(path))
    return message


def test_what_numpy_writes_is_read(tmp_path: Path) -> None:
    arrays = {
        "numbers": np.arange(6.0).reshape(2, 3),
        "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "whole": np.array([1, 2]),
        "flags": np.array([True, False]),
        "words": np.array(["r_N_x", "größe"]),
        "one": np.array(3.5),
        "none": np.zeros((0, 4)),
        "fixed.reference.camera": np.zeros(2, ">f4"),
    }
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
        found = read_arrays(tmp_path / "a.npz")
        assert list(found) == list(arrays)
        for name, values in arrays.items():
            np.testing.assert_array_equal(found[name], values)
            assert found[name].dtype == values.dtype


def test_a_header_that_states_more_than_there_is_costs_no_memory(tmp_path: Path) -> None:
    for shape in ("(100000000000,)", "(10**11,)", "(316228, 316228)", "(-1,)", "(" + "1," * 40 + ")"):
        path = _archive(tmp_path / "a.npz", ("covariance.npy", _member(_numbers(shape), bytes(64))))
        tracemalloc.start()
        try:
            _refusal(path)
            assert tracemalloc.get_traced_memory()[1] < 10**6
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (_numbers("(8,)"), "states 64 bytes and has 16 bytes"),
        (_numbers("(1,)"), "states 8 bytes and has 16 bytes"),
        (_numbers("(2,)", "'|O'"), "holds objects"),
        (_numbers("(1,)", "[('a', '<f8'), ('b', '<f8')]"), "holds"),
        (_numbers("(1,)", "('<f8', (2,))"), "holds"),
        (_numbers("(2,)", "'<c8'"), "holds complex64"),
        (_numbers("(1,)", "'|V16'"), "holds"),
        (_numbers("(2,)", "'nonsense'"), "not a valid dtype descriptor"),
        ("(" * 3000, "not a readable archive"),
        ("{'descr': __import__('os').system('true')}", "not a readable archive"),
        (b"\xff\xfe\x00" * 20, "not a readable archive"),
        ("x" * 5000, "not a readable archive"),
    ],
)
def test_odd_headers_are_refused(tmp_path: Path, header: str | bytes, message: str) -> None:
    path = _archive(tmp_path / "a.npz", ("values.npy", _member(header, bytes(16))))
    assert message in _refusal(path)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_objects_and_odd_repeated_or_too_many_names_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", values=np.array([{"a": 1}], dtype=object))
    assert "values holds objects" in _refusal(tmp_path / "a.npz")
    for name in ("../up.npy", "/etc/passwd.npy", "no_suffix", "a/b.npy", "a b.npy", ".npy"):
        assert "a member is called" in _refusal(_archive(tmp_path / "a.npz", (name, b"")))
    member = ("a.npy", _member(_numbers("(1,)"), bytes(8)))
    assert "2 arrays are called a" in _refusal(_archive(tmp_path / "a.npz", member, member))
    many = [(f"a{i}.npy", b"") for i in range(300)]
    assert "300 arrays" in _refusal(_archive(tmp_path / "a.npz", *many))


def test_an_archive_that_inflates_beyond_the_limit_is_not_inflated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(array_files, "LIMIT_BYTES", 10**6)
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6, np.uint8))
    assert (tmp_path / "a.npz").stat().st_size < 10**4
    assert "arrays of 1 MB, where 1 MB are allowed" in _refusal(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        (8, b"\x01", "encrypted"),
        (10, b"\x0e", "compressed by method 14"),
        (24, b"\x00\x00\x00\x10", "has 268"),
        (24, b"\xfe\xff\xff\xff", "allowed"),
        (42, b"\xff\xff\xff\x7f", "not a readable archive"),
        (16, b"\0\0\0\0", "CRC"),
    ],
)
def test_a_directory_that_lies_is_refused(tmp_path: Path, offset: int, value: bytes, message: str) -> None:
    """A field of the first entry of its directory is replaced."""
    path = _archive(tmp_path / "a.npz", ("a.npy", _member(_numbers("(2,)"), bytes(range(16)))))
    content = path.read_bytes()
    at = content.index(b"PK\1\2") + offset
    path.write_bytes(content[:at] + value + content[at + len(value) :])
    assert message in _refusal(path)


def test_damage_anywhere_is_an_error_of_one_line_or_none(tmp_path: Path) -> None:
    whole = io.BytesIO()
    np.savez_compressed(whole, a=np.arange(40.0), b=np.array(["x"]))
    content, rng = whole.getvalue(), np.random.default_rng(1)
    path = tmp_path / "a.npz"
    for _ in range(300):
        damaged = bytearray(content)
        for position in rng.integers(0, len(content), 3):
            damaged[position] = rng.integers(256)
        path.write_bytes(bytes(damaged[: rng.integers(1, len(content) + 1)]))
        with suppress(InputError):
            read_arrays(path)


def test_missing_and_unsuitable_arrays_are_named() -> None:
    arrays = {"a": np.zeros(3), "b": np.zeros((2, 2), dtype=np.int64)}
    require_arrays(Path("x.npz"), arrays, {"a": ("f", 1), "b": ("iu", 2)})
    with pytest.raises(InputError, match=r"x.npz: the array c is missing"):
        require_arrays(Path("x.npz"), arrays, {"c": ("f", 1)})
    with pytest.raises(InputError, match=r"x.npz: b is int64 of 2 dimensions"):
        require_arrays(Path("x.npz"), arrays, {"b": ("f", 2)})
