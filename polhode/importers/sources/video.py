"""One video with the two images side by side (left, right), or two videos, read by PyAV (FFmpeg).

Times are those of the container, in which some formats keep milliseconds only; a table (--stamps) or a rate
(--rate-hz) replaces them, and raw streams need one. A first reading, without decoding, counts the frames:
those that the container hides (the edit list of a trimmed MP4) are none. Frames are turned as the container
says.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.images import Raw
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import Contents, DecodedImage, FramedImage, Wanted
from polhode.importers.sources.ros_messages import grey_of_colour
from polhode.importers.times import read_times, require_increasing, require_plausible
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import require_part
from polhode.runtime.progress import Progress

SUFFIXES = (
    ".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".mts", ".h264", ".h265",
    ".264", ".265", ".hevc", ".mjpeg", ".mjpg", ".y4m", ".m2v", ".ivf", ".flv", ".wmv", ".mxf", ".3gp",
    ".ogv", ".obu",
)  # fmt: skip
RAW_STREAMS = {
    "h264": "H.264", "hevc": "H.265", "mjpeg": "motion JPEG", "m4v": "MPEG-4", "mpegvideo": "MPEG",
}  # fmt: skip
"""Names that FFmpeg has for streams without a container"""
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
    _numbers: tuple[dict[int, int], ...] = field(repr=False)
    """Of each video: the container's time of a frame -> its number; empty: frames are counted"""

    def images(self, wanted: Wanted) -> Iterator[FramedImage]:
        """The wanted images, in order of time; of two videos those of both in turn."""
        beside = len(self._paths) == 1
        for number, path in enumerate(self._paths):
            chosen = wanted[0] | wanted[1] if beside else wanted[number]
            for index, pixels in _decoded(path, chosen, self._numbers[number]):
                half = pixels.shape[1] // 2
                parts = [(0, pixels[:, :half]), (1, pixels[:, half:])] if beside else [(number, pixels)]
                for camera, part in parts:
                    if index in wanted[camera]:
                        yield FramedImage(camera, index, DecodedImage(part), f"{path}, frame {index}")


def open_videos(paths: Sequence[Path], options: ImportOptions, progress: Progress) -> Videos:
    """The videos, their times read. Raises InputError for what is damaged, of odd width, or without times."""
    require_part("av", "videos")
    if options.time_unit is not None and not options.stamps:
        raise InputError("--time-unit: videos have times of their own; give --stamps FILE, or leave it out")
    tables = options.stamps if len(options.stamps) == len(paths) else options.stamps * len(paths)
    stamps, numbers, bits, notes, origin = [], [], None, [], "the video's own times"
    for number, path in enumerate(paths):
        found = _frames(path, progress)
        bits = 16 if found.is_deep else bits
        if found.turned_deg:
            notes.append(f"{path.name}: turned by {found.turned_deg} degrees, as its tag says")
        if len(paths) == 1 and found.width_px % 2:
            raise InputError(
                f"{path}: {found.width_px} px wide, which is odd, so it is no two images side by side; give "
                "a video of two equal halves, or one for each camera"
            )
        if options.stamps:
            given = read_times(tables[number], options.time_unit, options.rate_hz)
            if len(given.stamps_ns) != found.count:
                raise InputError(
                    f"{tables[number]}: {len(given.stamps_ns)} timestamps for the {found.count} frames of "
                    f"{path}"
                )
            times, origin = given.stamps_ns, given.origin
        elif options.rate_hz is not None:
            times = np.array([round(k * 1e9 / options.rate_hz) for k in range(found.count)], dtype=np.int64)
            origin = "--rate-hz"
        else:
            times = np.array([round(pts * found.base * 10**9) for pts in found.pts], dtype=np.int64)
            if not len(times):
                raw = RAW_STREAMS.get(found.kind)
                what = "a video" if raw is None else f"a raw stream of {raw}"
                raise InputError(
                    f"{path}: {what}, whose frames have no times; give --rate-hz, or --stamps FILE"
                )
            require_plausible(path, times, "give --rate-hz, or --stamps FILE, if the video's times are wrong")
        require_increasing(path, times)
        stamps.append(times)
        numbers.append(found.numbers)
    contents = Contents((stamps[0], stamps[-1]), None, bits=bits, times=origin, notes=tuple(notes))
    return Videos(" and ".join(map(str, paths)), contents, tuple(paths), tuple(numbers))


@dataclass(frozen=True)
class _Frames:
    """What a first reading finds of the frames of a video."""

    kind: str
    """FFmpeg's name of the container, or of the stream without one"""
    count: int
    pts: tuple[int, ...]
    """Times in units of the base, in order; empty: the frames have none"""
    base: Fraction
    """[s]"""
    width_px: int
    """Turned as they are shown"""
    is_deep: bool
    """More than 8 bits"""
    turned_deg: int
    """Counterclockwise"""

    @property
    def numbers(self) -> dict[int, int]:
        """Time of a frame -> its number; empty: frames are counted."""
        # the packets of AVI have no times but their order
        return {} if self.kind == "avi" else {pts: k for k, pts in enumerate(self.pts)}


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise InputError for whatever FFmpeg raises."""
    import av

    try:
        yield
    except (av.error.FFmpegError, ValueError, IndexError) as error:
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: empty, damaged or cut off ({said}); {REPAIR.format(path)}") from error


def _frames(path: Path, progress: Progress) -> _Frames:
    """The frames by the packets of the container; of a raw stream by decoding all of them."""
    import av

    pts: list[int] = []
    count, width, height, turned_deg = 0, 0, 0, 0
    with _readable(path), av.open(str(path)) as container, progress.stage("reading times", 0) as advance:
        if not container.streams.video:
            raise InputError(f"{path}: no video in it; give a recording of the cameras")
        stream, kind = container.streams.video[0], container.format.name
        base, is_deep = Fraction(stream.time_base or 0), _is_deep(stream.format)
        for frame in container.decode(stream):
            width, height, turned_deg = frame.width, frame.height, int(frame.rotation) % 360
            _require_no_mirror(path, frame)
            if kind not in RAW_STREAMS:
                break
            count += 1
            advance()
        if kind not in RAW_STREAMS:
            container.seek(0)
            for packet in container.demux(stream):
                if packet.size and not packet.is_discard:
                    count += 1
                    pts += [] if packet.pts is None else [packet.pts]
                    advance()
    if not count or not width:
        raise InputError(f"{path}: a video without frames; {REPAIR.format(path)}")
    shown_px = height if turned_deg in (90, 270) else width
    known = tuple(sorted(pts)) if len(pts) == count else ()
    return _Frames(kind, count, known, base, shown_px, is_deep, turned_deg)


def _require_no_mirror(path: Path, frame: Any) -> None:
    """Raise InputError for a frame that is to be mirrored when it is shown."""
    for each in frame.side_data:
        if "DISPLAYMATRIX" in str(each.type):
            a, b, _, c, d = np.frombuffer(bytes(each), dtype=np.int32)[:5].astype(np.float64)
            if a * d - b * c < 0.0:
                raise InputError(
                    f"{path}: its tag mirrors the images; write it without (ffmpeg -i {path} -map_metadata "
                    "-1 ...), mirrored as it is to be seen"
                )


def _decoded(path: Path, wanted: frozenset[int], numbers: dict[int, int]) -> Iterator[tuple[int, Raw]]:
    """The wanted frames of a video, by their number, as grey pixels. ``numbers``: of times of the container;
    empty: frames are counted.
    """
    import av

    if not wanted:
        return
    missing, count = set(wanted), 0
    with _readable(path):
        container = av.open(str(path))
    try:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        frames = iter(container.decode(stream))
        while missing:
            with _readable(path):
                frame = next(frames, None)
                if frame is None:
                    break
                stamp = -1 if frame.pts is None else frame.pts
                number = numbers.get(stamp, -1) if numbers else count
                pixels = _grey(frame) if number in missing else None
            if pixels is not None:
                missing.discard(number)
                yield number, pixels
            count += 1
    finally:
        container.close()
    if missing:
        raise InputError(f"{path}: only the first {count} frames can be decoded; {REPAIR.format(path)}")


def _grey(frame: Any) -> Raw:
    """(H, W) the brightness of a frame, over the full range of 8 or 16 bits, turned as it is shown."""
    deep = _is_deep(frame.format)
    if frame.format.is_rgb and not deep:
        grey: Raw = grey_of_colour(frame.to_ndarray(format="rgb24"), "RGB")
    else:
        grey = frame.to_ndarray(format="gray16le" if deep else "gray")
    turns = int(frame.rotation) % 360 // 90
    if turns:
        grey = np.rot90(grey, turns).copy()
    return grey


def _is_deep(pixels: Any) -> bool:
    """Whether a format of pixels has more than 8 bits."""
    return pixels is not None and max((part.bits for part in pixels.components), default=8) > 8
