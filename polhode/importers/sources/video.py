"""One video with the two images side by side (left, right), or two videos, read by PyAV (FFmpeg).

Times are those of the container, in which some formats keep milliseconds only; a table (--stamps) or a rate
(--rate-hz) replaces them. A first reading, without decoding, counts the frames.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.images import Raw
from polhode.geometry.lie import Ints
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import Contents, DecodedImage, FramedImage, Wanted
from polhode.importers.sources.ros_messages import grey_of_colour
from polhode.importers.sources.stamp_files import read_stamps, require_increasing
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import require_part
from polhode.runtime.progress import Progress

SUFFIXES = (
    ".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".h264", ".h265", ".mjpeg",
)  # fmt: skip
REPAIR = "repair it (ffmpeg -i {0} -c copy repaired.mkv), or record it again"


def is_video(path: Path) -> bool:
    """Whether a path is a video, by its suffix."""
    return path.is_file() and path.suffix.lower() in SUFFIXES


@dataclass(frozen=True)
class Videos:
    """One video for both cameras, or one each."""

    name: str
    contents: Contents
    _paths: tuple[Path, ...] = field(repr=False)

    def images(self, wanted: Wanted) -> Iterator[FramedImage]:
        """The wanted images, in order of time; of two videos those of both in turn."""
        beside = len(self._paths) == 1
        for number, path in enumerate(self._paths):
            for index, pixels in _decoded(path, wanted[0] | wanted[1] if beside else wanted[number]):
                half = pixels.shape[1] // 2
                parts = [(0, pixels[:, :half]), (1, pixels[:, half:])] if beside else [(number, pixels)]
                for camera, part in parts:
                    if index in wanted[camera]:
                        yield FramedImage(camera, index, DecodedImage(part), f"{path}, frame {index}")


def open_videos(paths: Sequence[Path], options: ImportOptions, progress: Progress) -> Videos:
    """The videos, their times read. Raises InputError for what is damaged, of odd width, or without times."""
    require_part("av", "videos")
    tables = options.stamps if len(options.stamps) == len(paths) else options.stamps * len(paths)
    stamps, bits = [], None
    for number, path in enumerate(paths):
        times, width, is_deep = _times(path, progress)
        bits = 16 if is_deep else bits
        if len(paths) == 1 and width % 2:
            raise InputError(
                f"{path}: {width} px wide, which is odd, so it is no two images side by side; give a video "
                "of two equal halves, or one for each camera"
            )
        if options.stamps:
            given = read_stamps(tables[number])
            if len(given) != len(times):
                raise InputError(
                    f"{tables[number]}: {len(given)} timestamps for the {len(times)} frames of {path}"
                )
            times = given
        elif options.rate_hz is not None:
            times = np.array([round(k * 1e9 / options.rate_hz) for k in range(len(times))], dtype=np.int64)
        require_increasing(path, times)
        stamps.append(times)
    left, right = stamps[0], stamps[-1]
    return Videos(" and ".join(map(str, paths)), Contents((left, right), None, bits=bits), tuple(paths))


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise InputError for whatever FFmpeg raises."""
    import av

    try:
        yield
    except (av.error.FFmpegError, ValueError, IndexError) as error:
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: empty, damaged or cut off ({said}); {REPAIR.format(path)}") from error


def _times(path: Path, progress: Progress) -> tuple[Ints, int, bool]:
    """Times of the frames [ns] by the packets of the stream, width of the images [px], whether deep ones."""
    import av

    times: list[int] = []
    with _readable(path), av.open(str(path)) as container, progress.stage("reading times", 0) as advance:
        if not container.streams.video:
            raise InputError(f"{path}: no video in it; give a recording of the cameras")
        stream = container.streams.video[0]
        width, is_deep, base = int(stream.width), _is_deep(stream.format), stream.time_base or Fraction(0)
        for packet in container.demux(stream):
            if packet.size and packet.pts is not None:
                times.append(round(Fraction(packet.pts) * Fraction(base) * 10**9))
                advance()
    if not times:
        raise InputError(f"{path}: a video without frames; {REPAIR.format(path)}")
    return np.array(sorted(times), dtype=np.int64), width, is_deep


def _decoded(path: Path, wanted: frozenset[int]) -> Iterator[tuple[int, Raw]]:
    """The wanted frames of a video, by their number, as grey pixels."""
    import av

    if not wanted:
        return
    last, count = max(wanted), 0
    with _readable(path):
        container = av.open(str(path))
    try:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        frames = iter(container.decode(stream))
        while count <= last:
            with _readable(path):
                frame = next(frames, None)
                if frame is None:
                    break
                pixels = _grey(frame) if count in wanted else None
            if pixels is not None:
                yield count, pixels
            count += 1
    finally:
        container.close()
    if count <= last:
        raise InputError(f"{path}: only the first {count} frames can be decoded; {REPAIR.format(path)}")


def _grey(frame: Any) -> Raw:
    """(H, W) the brightness of a frame, over the full range of 8 or 16 bits."""
    deep = _is_deep(frame.format)
    if frame.format.is_rgb and not deep:
        return grey_of_colour(frame.to_ndarray(format="rgb24"), "RGB")
    grey: Raw = frame.to_ndarray(format="gray16le" if deep else "gray")
    return grey


def _is_deep(pixels: Any) -> bool:
    """Whether a format of pixels has more than 8 bits."""
    return pixels is not None and max((part.bits for part in pixels.components), default=8) > 8
