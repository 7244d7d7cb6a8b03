"""The header of a PLY file: what it states must fit the size of the file."""

from dataclasses import dataclass, field

from polhode.files.foreign_meshes.unsound import Unsound

_SIZES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "float16": 2, "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8,
    "float64": 8, "int64": 8, "uint64": 8,
}  # fmt: skip
"""Bytes of each type of a property."""
_FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")
_TEXT_ROWS = 400_000
_HEADER_BYTES, _HEADER_LINES, _ELEMENTS = 1 << 18, 2_000, 20
_INTEGERS = tuple(name for name in _SIZES if "int" in name or "char" in name or "short" in name)


@dataclass
class _Element:
    name: str
    count: int
    properties: list[str] = field(default_factory=list)
    fixed_bytes: int = 0
    """Of one row, with the counts of its lists and without their items"""


def require_sound_ply(content: bytes, most_rows: int) -> None:
    """Raises Unsound: no PLY, an unknown type, or more rows than are allowed or fit the file."""
    ascii_body, elements, body = _header(content)
    rows = sum(element.count for element in elements)
    if rows > (_TEXT_ROWS if ascii_body else most_rows):
        raise Unsound(f"{rows} rows, where {most_rows} are allowed, and {_TEXT_ROWS} as text")
    if ascii_body:
        lines = content.count(b"\n", body) + 1
        if not rows <= lines <= rows + 1_000:
            raise Unsound(f"{rows} rows stated, {lines} lines there")
        return
    least = sum(element.count * element.fixed_bytes for element in elements)
    if least > len(content) - body:
        raise Unsound(
            f"{rows} rows stated, which need {least} bytes or more; {len(content) - body} are there"
        )


def _header(content: bytes) -> tuple[bool, list[_Element], int]:
    """Whether the body is text, the elements, and where the body begins."""
    end = content.find(b"end_header", 0, _HEADER_BYTES)
    newline = content.find(b"\n", end, end + 100)
    if not content.startswith(b"ply") or end < 0 or newline < 0:
        raise Unsound("no header of a PLY")
    lines = content[:end].decode("ascii", errors="replace").splitlines()
    if len(lines) > _HEADER_LINES:
        raise Unsound(f"a header of {len(lines)} lines, where {_HEADER_LINES} are allowed")
    words = [line.split() for line in lines]
    if len(words) < 2 or len(words[1]) != 3 or words[1][0] != "format" or words[1][1] not in _FORMATS:
        raise Unsound("no format that is ascii or binary")
    elements: list[_Element] = []
    for line in words[2:]:
        _add(line, elements)
    if len(elements) > _ELEMENTS or len({element.name for element in elements}) < len(elements):
        raise Unsound("too many elements, or two of one name")
    return words[1][1] == "ascii", elements, newline + 1


def _add(line: list[str], elements: list[_Element]) -> None:
    """Take in a line of the header."""
    match line:
        case ["comment" | "obj_info", *_]:
            pass
        case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
            elements.append(_Element(name, int(count)))
        case ["property", "list", counts, items, name] if (
            elements and counts in _INTEGERS and items in _SIZES
        ):
            _add_property(elements[-1], name, _SIZES[counts])
        case ["property", kind, name] if elements and kind in _SIZES:
            _add_property(elements[-1], name, _SIZES[kind])
        case _:
            raise Unsound(f"a header with the line '{' '.join(line)[:60]}'")


def _add_property(element: _Element, name: str, size: int) -> None:
    if name in element.properties:
        raise Unsound(f"two properties {name[:40]}")
    element.properties.append(name)
    element.fixed_bytes += size
