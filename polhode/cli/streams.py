"""Standard input, output and error as a command finds them: closed, full, or with a reader that went away.

The work does not depend on who reads what it prints.
"""

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO


@dataclass
class Streams:
    """What became of the output."""

    lost: str = ""
    """Why standard output could not be written; empty: it could, or nobody reads it any more"""


@contextmanager
def tolerant_streams() -> Iterator[Streams]:
    """Within the block, writing to standard output or error raises nothing.

    Where the reader has gone, the rest goes to the null device. Where writing fails, it does too, and
    ``Streams.lost`` says why. Streams that were replaced (by tests) stay as they are.
    """
    # Descriptors that are closed: else the first files that are opened would get their numbers, and what
    # libraries print.
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != descriptor:
                os.dup2(opened, descriptor)
                os.close(opened)
    streams, before = Streams(), (sys.stdout, sys.stderr)
    sys.stdout = _tolerant(sys.stdout, sys.__stdout__, streams)
    sys.stderr = _tolerant(sys.stderr, sys.__stderr__, Streams())
    try:
        yield streams
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(ValueError):  # closed
                stream.flush()
        sys.stdout, sys.stderr = before


class _Sink(io.FileIO):
    """A file descriptor that accepts everything."""

    def __init__(self, descriptor: int, streams: Streams) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._streams, self._is_terminal = streams, self.isatty()

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            hung_up = error.errno == errno.EIO and self._is_terminal
            if error.errno != errno.EPIPE and not hung_up:
                self._streams.lost = error.strerror or str(error)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())
            os.close(null)
            return len(data)


def _tolerant(stream: TextIO | None, original: TextIO | None, streams: Streams) -> TextIO:
    """The stream, writing through a sink; one to the null device if there is none."""
    if stream is None:
        return Path(os.devnull).open("w", encoding="utf-8")
    if stream is not original or not isinstance(stream, io.TextIOWrapper):
        return stream
    with suppress(OSError):
        stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Sink(stream.fileno(), streams)),
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
