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


@dataclass
class _Element:
    name: str
    count: int
    properties: set[str] = field(default_factory=set)
    fixed_bytes: int = 0
    """Of one row, with the counts of its lists and without their items"""


def require_sound_ply(content: bytes, most_rows: int) -> None:
    """Raises Unsound: no PLY, an unknown type, or more rows than are allowed or fit the file."""
    end = content.find(b"end_header", 0, _HEADER_BYTES)
    body = content.find(b"\n", end, end + 100) + 1
    if not content.startswith(b"ply") or end < 0 or body < 1:
        raise Unsound("no header of a PLY")
    lines = [line.split() for line in content[:end].decode("ascii", errors="replace").splitlines()]
    if len(lines) > _HEADER_LINES:
        raise Unsound(f"a header of {len(lines)} lines, where {_HEADER_LINES} are allowed")
    if len(lines) < 2 or len(lines[1]) != 3 or lines[1][0] != "format" or lines[1][1] not in _FORMATS:
        raise Unsound("no format that is ascii or binary")
    elements = _elements(lines[2:])
    is_text, rows = lines[1][1] == "ascii", sum(element.count for element in elements)
    if rows > (_TEXT_ROWS if is_text else most_rows):
        raise Unsound(f"{rows} rows, where {most_rows} are allowed, and {_TEXT_ROWS} as text")
    there = content.count(b"\n", body) + 1 if is_text else len(content) - body
    least = sum(element.count * element.fixed_bytes for element in elements)
    if is_text and not rows <= there <= rows + 1_000:
        raise Unsound(f"{rows} rows stated, {there} lines there")
    if not is_text and least > there:
        raise Unsound(f"{rows} rows stated, which need {least} bytes or more; {there} are there")


def _elements(lines: list[list[str]]) -> list[_Element]:
    """The elements that the lines of a header state."""
    elements: list[_Element] = []
    for line in lines:
        match line:
            case ["comment" | "obj_info", *_]:
                pass
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
                elements.append(_Element(name, int(count)))
            case ["property", *kinds, name] if elements and _first_size(kinds):
                if name in elements[-1].properties:
                    raise Unsound(f"two properties {name[:40]}")
                elements[-1].properties.add(name)
                elements[-1].fixed_bytes += _first_size(kinds)
            case _:
                raise Unsound(f"a header with the line '{' '.join(line)[:60]}'")
    if len(elements) > _ELEMENTS or len({element.name for element in elements}) < len(elements):
        raise Unsound("too many elements, or two of one name")
    return elements


def _first_size(kinds: list[str]) -> int:
    """Bytes of a value, or of the count of a list; 0: no such types."""
    if len(kinds) == 3 and kinds[0] == "list" and kinds[2] in _SIZES and "float" not in kinds[1]:
        return _SIZES.get(kinds[1], 0) if kinds[1] != "double" else 0
    return _SIZES.get(kinds[0], 0) if len(kinds) == 1 else 0
