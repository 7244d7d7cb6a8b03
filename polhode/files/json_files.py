"""Reading JSON that others wrote: of limited size and depth, without NaN, each key once."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any, NoReturn

from polhode.files.foreign_files import MIB, read_text
from polhode.runtime.errors import InputError

JSON_BYTES = 4 * MIB
"""Limit of a run's files; a summary has 10 kB, and one with a thousand pushes some 500."""
MAX_DEPTH = 32
MAX_NUMBER_LENGTH = 64
"""Python reads at most 4300 digits, in a time that grows with their square"""


def read_json(path: Path, kind: str, limit_bytes: int = JSON_BYTES) -> Any:
    """The content of a JSON file; ``kind`` names what it is, for the message: "a summary".

    Raises MissingFile, and InputError, one line, for what is not a regular file, larger, nested deeper, not
    valid JSON, or ambiguous: a key given twice, NaN, infinity.
    """
    text = read_text(path, limit_bytes, kind)
    too_deep = f"{path}: nested more than {MAX_DEPTH} deep; not a file that polhode wrote"

    def each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
            raise ValueError(f"key {twice[:60]!r} is given twice; keep one of them")
        return content

    def no_number(name: str) -> NoReturn:
        raise ValueError(f"{name} is no number of JSON; write null")

    def finite(text: str) -> float:
        if not math.isfinite(number := float(text)):
            raise ValueError(f"{text[:20]} is beyond the range of numbers")
        return number

    def whole(text: str) -> int:
        if len(text) > MAX_NUMBER_LENGTH:
            raise ValueError(f"a number of {len(text)} digits; give at most {MAX_NUMBER_LENGTH}")
        return int(text)

    hooks: Any = {"object_pairs_hook": each_key_once, "parse_constant": no_number}
    try:
        content = json.loads(text, parse_float=finite, parse_int=whole, **hooks)
    except json.JSONDecodeError as error:
        raise InputError(f"{path} line {error.lineno}: not valid JSON: {error.msg}") from None
    except RecursionError:
        raise InputError(too_deep) from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    level = [content]
    for _ in range(MAX_DEPTH + 1):
        inner = [
            each.values() if isinstance(each, dict) else each
            for each in level
            if isinstance(each, dict | list)
        ]
        level = [part for parts in inner for part in parts]
    if level:
        raise InputError(too_deep)
    return content
