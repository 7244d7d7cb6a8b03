"""Reading archives of arrays (.npz) that others made: what they state is compared with what they hold.

NumPy allocates what the header of an array states, 745 GiB if it says so, and inflates whatever a zip file
contains. Here the directory of the zip file and the header of each array are checked first, so that memory is
bounded by ``LIMIT_BYTES`` and nothing is unpickled.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from polhode.files.foreign_files import MIB, amount, open_regular
from polhode.runtime.errors import InputError, one_line

LIMIT_BYTES = 512 * MIB
"""Of a file, and of all arrays in it."""
MAX_ARRAYS = 200
_HEADER_BYTES = 4096


class _Refused(Exception):
    """The reason why an archive is not read."""


def read_arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    """All arrays of an archive by name: numbers, booleans and texts of at most 512 MiB together.

    Raises InputError, one line: no regular file, no zip file, damaged, encrypted, too large, an odd or
    repeated name, an array that has another size than its header states, or one of objects.
    """
    with open_regular(path, LIMIT_BYTES, "an archive of arrays") as stream:
        try:
            with ZipFile(stream) as archive:
                members = archive.infolist()
                _require_sensible(members)
                return {member.filename.removesuffix(".npy"): _read(archive, member) for member in members}
        except _Refused as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001  damage raises errors of many types
            reason = one_line(str(error) or type(error).__name__)[:160]
    raise InputError(f"{path}: not a readable archive of arrays ({reason})")


def _require_sensible(members: list[ZipInfo]) -> None:
    """What the directory of the zip file says. Raises _Refused."""
    if len(members) > MAX_ARRAYS:
        raise _Refused(f"{len(members)} arrays, where {MAX_ARRAYS} are allowed")
    total = sum(member.file_size for member in members)
    if total > LIMIT_BYTES:
        raise _Refused(f"arrays of {amount(total)}, where {amount(LIMIT_BYTES)} are allowed")
    for name, count in Counter(member.filename for member in members).items():
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_.]{0,99}\.npy", name):
            raise _Refused(f"a member is called {name[:40]!r}")
        if count > 1:
            raise _Refused(f"{count} arrays are called {name.removesuffix('.npy')}")
    for member in members:
        if member.flag_bits & 0x1:
            raise _Refused("encrypted")
        if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            raise _Refused(f"compressed by method {member.compress_type}, which NumPy does not write")


def _read(archive: ZipFile, member: ZipInfo) -> NDArray[np.generic]:
    """An array, allocated only when its header fits the size of the member. Raises _Refused and others."""
    name = member.filename.removesuffix(".npy")
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
        if read is None:
            raise _Refused(f"arrays of format {version[0]}.{version[1]}")
        shape, _, dtype = read(stream, max_header_size=_HEADER_BYTES)
        start = stream.tell()
    if dtype.hasobject or dtype.kind not in "biufU" or dtype.subdtype is not None:
        raise _Refused(f"{name} holds {'objects' if dtype.hasobject else str(dtype)[:60]}")
    if len(shape) > 8 or any(size < 0 for size in shape):
        raise _Refused(f"{name} has the shape {str(shape)[:60]}")
    stated, there = math.prod(shape) * dtype.itemsize, member.file_size - start
    if stated != there:
        raise _Refused(f"{name} states {amount(stated)} and has {amount(there)}")
    with archive.open(member) as stream:
        values = npy.read_array(stream, allow_pickle=False, max_header_size=_HEADER_BYTES)
        if stream.read(1):
            raise _Refused(f"{name} is longer than stated")
    return values


def require_arrays(
    path: Path, arrays: Mapping[str, NDArray[np.generic]], expected: Mapping[str, tuple[str, int]]
) -> None:
    """Require arrays of these names, each with its kind of dtype ("f", "iu") and its number of dimensions.

    Raises InputError.
    """
    for name, (kinds, dimensions) in expected.items():
        if name not in arrays:
            raise InputError(f"{path}: the array {name} is missing")
        values = arrays[name]
        if values.dtype.kind not in kinds or values.ndim != dimensions:
            raise InputError(f"{path}: {name} is {values.dtype} of {values.ndim} dimensions")
