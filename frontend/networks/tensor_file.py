"""Reading safetensors files of others: named tensors, from which nothing is executed.

Size, names, shapes and kinds of numbers are compared with those expected before any tensor is read, so that a
file of another network, however large, costs no memory.
"""

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from polhode.files.foreign_files import MIB, amount

MAX_HEADER_BYTES = 16 * MIB
_KINDS = {torch.float32: "F32", torch.float64: "F64", torch.int64: "I64", torch.bool: "BOOL"}


class TensorFileError(Exception):
    """What is wrong with a file of tensors, in words without the file's name."""


def read_tensors(path: Path, expected: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors of a safetensors file, on the CPU, and the texts of its header.

    Raises TensorFileError: it is no such file, or has other tensors than ``expected``, or numbers that are
    not finite.
    """
    limit = MAX_HEADER_BYTES + sum(tensor.nbytes for tensor in expected.values())
    try:
        size = path.stat().st_size
        if size > limit:
            raise TensorFileError(f"another network (it has {amount(size)}, more than {amount(limit)})")
        with safe_open(path, "pt") as file:
            given = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118  it is no mapping
            _compare({name: (slot.get_shape(), slot.get_dtype()) for name, slot in given.items()}, expected)
            tensors = {name: file.get_tensor(name) for name in expected}
            header = dict(file.metadata() or {})
    except (SafetensorError, OSError, RuntimeError, ValueError) as error:
        raise _no_tensor_file(error) from None
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise TensorFileError(f"{_short(name)} holds NaN or infinity")
    return tensors, header


def read_header(path: Path) -> dict[str, str]:
    """The texts of the header of a safetensors file. Raises TensorFileError: it is no such file."""
    try:
        with safe_open(path, "pt") as file:
            return dict(file.metadata() or {})
    except (SafetensorError, OSError, RuntimeError, ValueError) as error:
        raise _no_tensor_file(error) from None


def _no_tensor_file(error: Exception) -> TensorFileError:
    return TensorFileError(f"not a safetensors file ({' '.join(str(error).split())[:120]})")


def _compare(given: Mapping[str, tuple[list[int], str]], expected: Mapping[str, Tensor]) -> None:
    wanted = {name: (list(tensor.shape), _KINDS[tensor.dtype]) for name, tensor in expected.items()}
    differ = [name for name in wanted if given.get(name) != wanted[name]]
    differ += [name for name in given if name not in wanted]
    if differ:
        first = differ[0]
        raise TensorFileError(
            f"another network ({len(differ)} tensors differ, the first is {_short(first)}: "
            f"{_described(given.get(first))}, expected {_described(wanted.get(first))})"
        )


def _described(tensor: tuple[list[int], str] | None) -> str:
    if tensor is None:
        return "none"
    shape, kind = tensor
    return f"{kind} {' x '.join(map(str, shape[:6])) or 'scalar'}"


def _short(name: str) -> str:
    return " ".join(name.split())[:80]
