"""Results of the steps as numbers in a row: nested sections by names with dots, short vectors by position."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

NOT_OF_A_RUN = frozenset(
    {"schema_", "files", "data", "timing_s", "verdict", "status", "warnings", "words", "own_sha256"}
)
"""Keys of a summary that say nothing of the answer, or stand in columns of their own"""

Metrics = dict[str, bool | int | float | str | None]


def flattened(prefix: str, values: Mapping[str, Any], without: frozenset[str] = frozenset()) -> Metrics:
    """Numbers, truths and short texts below ``prefix``; what is not finite is None."""
    return dict(_leaves(prefix, {key: each for key, each in values.items() if key not in without}))


def as_json(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same as JSON has it: arrays as lists, what is not finite as None. Raises TypeError."""
    if not isinstance(values, Mapping):
        raise TypeError(f"a function that measures returns a dictionary, not {type(values).__name__}")
    found: dict[str, Any] = _plain(values)
    return found


def _plain(value: Any) -> Any:
    """Models as dictionaries, arrays as lists."""
    value = value.model_dump() if isinstance(value, BaseModel) else value
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if value is None or isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    if isinstance(value, float):
        return None
    raise TypeError(f"a measured value is no number, text or list of them: {type(value).__name__}")


def _leaves(name: str, value: Any) -> Iterator[tuple[str, bool | int | float | str | None]]:
    value = _plain(value)
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from _leaves(f"{name}.{key}", each)
    elif isinstance(value, list):
        # short vectors by position
        if len(value) <= 3 and not any(isinstance(each, list | Mapping | str) for each in value):
            yield from ((f"{name}.{position}", each) for position, each in enumerate(value))
    elif not isinstance(value, str) or len(value) <= 40:
        yield name, value
