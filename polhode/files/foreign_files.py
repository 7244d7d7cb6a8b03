"""Opening the files that others made: regular files only, of a limited size, each error one line.

A dataset, a configuration or a run may come from anywhere. A name in it that turns out to be a device, a
pipe, a socket or a folder is refused before a byte is read, so that nothing waits for a writer or reads
without end, and a file larger than any of its kind is refused before it fills the memory. Links are followed.
"""

import codecs
import hashlib
import os
import stat
from pathlib import Path
from typing import BinaryIO

from polhode.runtime.errors import InputError

KIB, MIB, GIB = 2**10, 2**20, 2**30
CONFIGURATION_BYTES = MIB
"""Limit of a YAML file: the resolved configuration has 12 kB, and a scene with 5000 waypoints some 500."""


class MissingFile(InputError):
    """There is no file of this name."""


def open_regular(path: Path, limit_bytes: int, kind: str) -> BinaryIO:
    """Open a regular file of at most ``limit_bytes`` for reading; the caller closes it.

    ``kind`` names what the file is, for the message: "a table". The file may grow while it is read, and files
    of /proc state no size: a caller that must not read more than the limit reads by ``read_bytes``. Raises
    MissingFile, and InputError for what is no regular file, is too large, or cannot be opened.
    """
    try:
        # Opening a pipe or a device can have effects: the kind is looked at before, and again after.
        _require_regular(path, path.stat().st_mode)
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except FileNotFoundError:
        raise MissingFile(f"{_shown(path)} is missing: give an existing file") from None
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    try:
        opened = os.fstat(descriptor)
        _require_regular(path, opened.st_mode)
        if opened.st_size > limit_bytes:
            raise _too_large(path, opened.st_size, limit_bytes, kind)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_bytes(path: Path, limit_bytes: int, kind: str) -> bytes:
    """The content of a regular file of at most ``limit_bytes``. Raises as ``open_regular``."""
    with open_regular(path, limit_bytes, kind) as stream:
        try:
            # Reading makes a buffer of the size that is asked for: the stated size, and more only if it grew.
            content = stream.read(os.fstat(stream.fileno()).st_size)
            if more := stream.read(1):
                content += more + stream.read(limit_bytes - len(content))
        except OSError as error:
            raise _unreadable(path, error) from None
    if len(content) > limit_bytes:
        raise _too_large(path, len(content), limit_bytes, kind)
    return content


def sha256_of(path: Path, limit_bytes: int, kind: str) -> str:
    """The SHA-256, hexadecimal, of a regular file of at most ``limit_bytes``. Raises as ``open_regular``."""
    digest = hashlib.sha256()
    with open_regular(path, limit_bytes, kind) as stream:
        try:
            while part := stream.read(MIB):
                digest.update(part)
        except OSError as error:
            raise _unreadable(path, error) from None
    return digest.hexdigest()


def read_text(path: Path, limit_bytes: int, kind: str) -> str:
    """The same as text: UTF-8, with or without a byte order mark. Raises InputError for other encodings."""
    return decoded(path, read_bytes(path, limit_bytes, kind))


def decoded(path: Path, content: bytes) -> str:
    """UTF-8 ``content`` of ``path`` as text. Raises InputError, which names the line that is not."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path} is UTF-16 text: save it as UTF-8")
    if b"\0" in content:
        line = content.count(b"\n", 0, content.index(b"\0")) + 1
        raise InputError(f"{path} line {line}: a zero byte, so this is not UTF-8 text: save it as UTF-8")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path} line {line}: byte 0x{content[error.start]:02x} is not UTF-8: save the file as UTF-8"
        ) from None


def _require_regular(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
        kinds |= {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
        kind = kinds.get(stat.S_IFMT(mode), "no regular file")
        raise InputError(f"{path} is {kind}: give a regular file")


def _too_large(path: Path, size: int, limit_bytes: int, kind: str) -> InputError:
    return InputError(
        f"{path} has {amount(size)}, more than the {amount(limit_bytes)} that {kind} may have: "
        "give a smaller one"
    )


def _unreadable(path: Path, error: OSError | ValueError) -> InputError:
    """A name with a zero byte is a ValueError."""
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return InputError(f"{_shown(path)} cannot be read ({reason}): correct the name or the permissions")


def _shown(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 300 else f"{text[:120]}...{text[-120:]}"


def amount(size: int) -> str:
    """Bytes in words: '12 kB'."""
    for unit, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= unit:
            return f"{size / unit:,.1f}".removesuffix(".0") + f" {name}"
    return f"{size} bytes"
