"""The options of ``polhode export``, checked before anything is read."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from polhode.config.keys import suggestion
from polhode.planning.exports.formats import FORMATS, MESHES, MOTIONS, ROBOTS, Format
from polhode.planning.keep_out.measured_body import Cover
from polhode.planning.predict import require_step
from polhode.runtime.errors import InputError

FrameName = Literal["G", "P"]
Unit = Literal["m", "mm"]
Poses = Literal["predicted", "estimated"]
"""After the last frame, or at the frames"""
METRES: dict[str, float] = {"m": 1.0, "mm": 1e-3}
MAX_PIECES = 1024
MIN_MASS, MAX_MASS = 1e-9, 1e15
"""[kg], and of the moment [kg m^2]."""


@dataclass(frozen=True)
class ExportOptions:
    """The options of the command; its docstrings are there."""

    to: Format
    output: Path
    frame: FrameName | None = None
    unit: Unit = "m"
    mass_kg: float | None = None
    middle_moment_kg_m2: float | None = None
    pieces: int = 512
    cover: Cover = "auto"
    poses: Poses = "predicted"
    horizon: float = 60.0
    step_s: float | None = None
    epoch: str = "1970-01-01T00:00:00"
    object_name: str = "target"
    object_id: str = "UNKNOWN"

    @property
    def frame_name(self) -> FrameName:
        """P for motion, G for everything else, unless given."""
        return self.frame or ("P" if self.to in MOTIONS else "G")

    @property
    def epoch_utc(self) -> np.datetime64:
        """UTC at timestamp 0 [ns]."""
        try:
            time = datetime.fromisoformat(self.epoch)
        except ValueError:
            raise InputError(f"--epoch {self.epoch}: not a time; give UTC as 2026-01-31T12:00:00") from None
        if time.tzinfo is not None:
            time = time.astimezone(UTC).replace(tzinfo=None)
        if not 1900 <= time.year < 2200:
            raise InputError(f"--epoch {self.epoch}: give a time from 1900 to 2199")
        return np.datetime64(time, "ns")


def check(options: ExportOptions) -> None:
    """Raise InputError, one line, for options that contradict each other or a file that cannot be written."""
    to = options.to
    _require_one_of("--to", to, FORMATS)
    _require_one_of("--frame", options.frame_name, get_args(FrameName))
    _require_one_of("--unit", options.unit, get_args(Unit))
    suffix = options.output.suffix.lower().removeprefix(".")
    if suffix in FORMATS and suffix != to:
        raise InputError(
            f"-o {options.output}: .{suffix} is the suffix of another format than {to}; "
            f"give {options.output.with_suffix('.' + to).name}, or --to {suffix}"
        )
    if options.unit == "mm" and to not in MESHES:
        raise InputError(f"--unit mm: {to} has lengths of its own; the unit is for {', '.join(MESHES)}")
    _require_one_of("--poses", options.poses, get_args(Poses))
    if options.poses == "estimated" and to != "tum":
        raise InputError(f"--poses estimated: only tum can have the poses at the frames, not {to}")
    if to == "oem" and options.frame_name != "P":
        raise InputError(
            f"--frame {options.frame_name}: an OEM is the path of the centre of mass, the origin of P; "
            "leave it out"
        )
    for name, value in (
        ("--mass-kg", options.mass_kg),
        ("--middle-moment-kg-m2", options.middle_moment_kg_m2),
    ):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} {value:g}: give a number above 0")
        if value is not None and not MIN_MASS <= value <= MAX_MASS:
            raise InputError(f"{name} {value:g}: give a number from {MIN_MASS:g} to {MAX_MASS:g}")
    if options.step_s is not None:
        require_step(options.step_s)
    if not 1 <= options.pieces <= MAX_PIECES:
        raise InputError(f"--pieces {options.pieces}: give 1 (the convex hull) to {MAX_PIECES}")
    _require_one_of("--cover", options.cover, get_args(Cover))
    if options.cover != "auto" and to not in ROBOTS:
        raise InputError(
            f"--cover {options.cover}: {to} has no collision geometry; the option is for {', '.join(ROBOTS)}"
        )
    for name, text in (("--object-name", options.object_name), ("--object-id", options.object_id)):
        if not re.fullmatch(r"[A-Za-z0-9_.+-]{1,64}", text):
            raise InputError(f"{name} '{text[:64]}': give up to 64 letters, digits and _ . + - only")
    if options.object_name in ("N", "P", "world"):
        raise InputError(f"--object-name {options.object_name}: this is the name of a frame; give another")
    _ = options.epoch_utc


def _require_one_of(option: str, value: str, valid: Sequence[str]) -> None:
    if value not in valid:
        hint = suggestion(str(value), valid)
        raise InputError(f"{option} '{value}': unknown;{hint} give one of {' '.join(valid)}")


def creation_date() -> str:
    """Now, in UTC; the variable SOURCE_DATE_EPOCH (seconds, reproducible-builds.org) overrides it."""
    text = os.environ.get("SOURCE_DATE_EPOCH", "")
    given = text.isascii() and text.isdigit() and len(text) <= 11
    now = datetime.fromtimestamp(int(text), UTC) if given else datetime.now(UTC)
    return now.strftime("%Y-%m-%dT%H:%M:%S")
