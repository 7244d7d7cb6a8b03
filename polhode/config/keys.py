"""The tree of configuration keys, derived from the types: the valid values of each, for help and errors."""

import difflib
import types
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

Step = str | int
Path = tuple[Step, ...]


def dotted(path: Sequence[Step]) -> str:
    """('backend', 'inertia') -> 'backend.inertia'."""
    return ".".join(str(step) for step in path)


def leaves(section: type[BaseModel], prefix: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every key that holds a value rather than a section, with its type: (path, annotation)."""
    for name, field in section.model_fields.items():
        path = (*prefix, name)
        inner = section_of(field.annotation)
        if inner is None:
            yield path, field.annotation
        else:
            yield from leaves(inner, path)


def section_of(annotation: Any) -> type[BaseModel] | None:
    """The section behind ``Section`` or ``Section | None``; None for a value."""
    for option in options_of(annotation):
        if isinstance(option, type) and issubclass(option, BaseModel):
            return option
    return None


def options_of(annotation: Any) -> tuple[Any, ...]:
    """Members of a union, stripped of Annotated; a single type is a union of one."""
    if get_origin(annotation) is Annotated:
        return options_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return tuple(option for member in get_args(annotation) for option in options_of(member))
    return (annotation,)


def section_at(root: type[BaseModel], path: Sequence[Step]) -> type[BaseModel] | None:
    """The section at ``path``; None for the path of a value or a path that does not exist."""
    return section_of(annotation_at(root, path))


def annotation_at(root: type[BaseModel], path: Sequence[Step]) -> Any:
    """The type at ``path``; None for a path that does not exist. A mapping takes any key."""
    annotation: Any = root
    for step in path:
        section = section_of(annotation)
        if section is not None:
            field = section.model_fields.get(str(step))
            annotation = field.annotation if field else None
        else:
            mappings = [option for option in options_of(annotation) if get_origin(option) is dict]
            annotation = get_args(mappings[0])[1] if mappings else None
    return annotation


def is_structured(annotation: Any) -> bool:
    """Whether the value is a list of sections or a mapping: one word of YAML on a command line."""
    for option in options_of(annotation):
        origin, arguments = get_origin(option), get_args(option)
        if origin is dict or (origin in (tuple, list) and section_of(arguments[0]) is not None):
            return True
    return False


def count_of(annotation: Any) -> int | None:
    """Number of words of the value on a command line; None: as many as follow."""
    if is_structured(annotation):
        return 1
    for option in options_of(annotation):
        origin, arguments = get_origin(option), get_args(option)
        if origin is tuple and arguments[-1:] != (...,):
            counts = [count_of(argument) for argument in arguments]
            return None if None in counts else sum(count for count in counts if count is not None)
        if origin in (tuple, list, dict, set, frozenset):
            return None
    return 1


def arrange(annotation: Any, words: Sequence[str]) -> Any:
    """Words of a command line as the value for pydantic to convert: a text, or (nested) lists of texts."""
    for option in options_of(annotation):
        arguments = get_args(option)
        if get_origin(option) is tuple and arguments[-1:] != (...,) and len(words) == count_of(option):
            values, rest = [], list(words)
            for argument in arguments:
                count = count_of(argument) or 1
                values.append(arrange(argument, rest[:count]))
                rest = rest[count:]
            return values
        size = count_of(arguments[0]) if get_origin(option) is tuple and arguments[-1:] == (...,) else None
        if size is not None and size > 1 and len(words) % size == 0:
            return [arrange(arguments[0], words[k : k + size]) for k in range(0, len(words), size)]
    if len(words) != 1 or count_of(annotation) != 1:
        return list(words)
    # of numbers such as 1, 4, 9 the number, which a text would not match
    choices = [
        each
        for option in options_of(annotation)
        if get_origin(option) is Literal
        for each in get_args(option)
    ]
    return next((choice for choice in choices if str(choice) == words[0]), words[0])


WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false", type(None): "null"}


def describe(annotation: Any) -> str:
    """Description of a type, for an error: 'a number', 'one of a, b'."""

    def one(option: Any) -> str:
        origin, arguments = get_origin(option), get_args(option)
        if option in WORDS:
            return WORDS[option]
        if origin is Literal:
            return f"one of {', '.join(str(choice) for choice in arguments)}"
        if origin is dict:
            return f"a mapping of names, each {describe(arguments[1])}"
        if origin in (tuple, list):
            is_fixed = origin is tuple and arguments[-1] is not ...
            return f"a list{f' of {len(arguments)}' if is_fixed else ''}, each {describe(arguments[0])}"
        if isinstance(option, type) and issubclass(option, BaseModel):
            return f"a section with keys {', '.join(option.model_fields)}"
        return str(option)

    return " or ".join(dict.fromkeys(map(one, options_of(annotation))))


def elsewhere(root: type[BaseModel], name: str) -> str:
    """The same for a name that a key of another section has: ' did you mean section.x?'."""
    known = {path[-1]: dotted(path) for path, _ in leaves(root)}
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
    return f" did you mean {known[close[0]]}?" if close else ""


def suggestion(word: str, valid: Sequence[str]) -> str:
    """' did you mean x?' where something is close, else nothing."""
    close = difflib.get_close_matches(word, valid, n=1, cutoff=0.6)
    return f" did you mean {close[0]}?" if close else ""
