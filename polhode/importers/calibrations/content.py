"""A calibration file of any kind as a mapping: YAML, YAML 1.0 and XML of OpenCV, JSON, INI, arrays of
NumPy.
"""

import configparser
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

from polhode.files.array_files import read_arrays
from polhode.files.foreign_files import CONFIGURATION_BYTES, MissingFile, read_text
from polhode.files.yaml_files import parse_yaml
from polhode.runtime.errors import InputError

BINARY = (".npy", ".pkl", ".pickle", ".mat", ".bin", ".h5", ".hdf5", ".png", ".jpg", ".svo", ".bag", ".mcap")
"""Suffixes of files that are no calibration here"""
MAX_ARRAY_BYTES = 100_000
"""Of an array in a calibration; maps of distortion, which have millions, are not read"""


def read_content(path: Path, kinds: str) -> dict[str, Any]:
    """The content of a calibration file. ``kinds``: formats that are read, for the message.

    Raises InputError for what is missing, no text, or has no keys.
    """
    if path.suffix.lower() == ".npz":
        return _arrays(path, kinds)
    if path.suffix.lower() in BINARY:
        raise InputError(f"{path}: a {path.suffix.lower()} file, which is not read; give {kinds}")
    try:
        text = read_text(path, CONFIGURATION_BYTES, "a calibration").lstrip("\ufeff")
    except MissingFile:
        raise InputError(f"{path} is missing: give {kinds}") from None
    if re.match(r"\s*<[?\w]", text):
        return _xml(path, text)
    if re.search(r"^\[[A-Z_0-9]*CAM[A-Z_0-9]*\]\s*$", text, re.MULTILINE):
        return _ini(path, text)
    rows = re.findall(r"^(\w+): (.*)$", text, re.MULTILINE)
    # KITTI's rows of numbers without brackets are no YAML
    if any(re.fullmatch(r"P\d|P_rect_\d\d", name) for name, _ in rows):
        return dict(rows)
    try:
        found = parse_yaml(plain_yaml(text), str(path))
    except InputError as error:
        if path.suffix.lower() in (".yaml", ".yml", ".json"):
            raise
        raise InputError(f"{path}: of no format that is read ({error}); give {kinds}") from None
    if isinstance(found, dict):
        # Basalt wraps all of it, a list of one document is what some scripts write
        return found["value0"] if isinstance(found.get("value0"), dict) else found
    raise InputError(f"{path} is no calibration, since it has no keys: give {kinds}")


def plain_yaml(text: str) -> str:
    """YAML as its standard has it, of what OpenCV's FileStorage and ``ros2 topic echo`` write."""
    text = re.sub(r"\A%YAML[: ]1\.[012]\s*(---)?", "", text).replace("!!opencv-matrix", "")
    # one message of several
    text = re.split(r"^---\s*$", text.removeprefix("---\n").strip() + "\n", maxsplit=1, flags=re.MULTILINE)[0]
    # a key needs no blank after its colon there
    text = re.sub(r"^(\s*[\w.]+):(?=[\[\"\d])", r"\1: ", text, flags=re.MULTILINE)
    return re.sub(r"(?<![\w.])\.Nan\b", ".nan", text)


def _xml(path: Path, text: str) -> dict[str, Any]:
    """The matrices and values of OpenCV's XML."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: XML with a document type; give a calibration of OpenCV, without it")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314  without a document type it has no entities
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not valid XML: {str(error)[:100]}") from None
    if root.tag != "opencv_storage":
        return {root.tag: {child.tag: (child.text or "").strip() for child in root}}
    values: dict[str, Any] = {}
    for child in root:
        data = child.find("data")
        words = ((data.text if data is not None else child.text) or "").replace('"', " ").split()
        values[child.tag] = words if data is not None or len(words) != 1 else words[0]
    return values


def _ini(path: Path, text: str) -> dict[str, Any]:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise InputError(f"{path}: not valid INI: {' '.join(str(error).split())[:100]}") from None
    return {name: dict(parser[name]) for name in parser.sections()}


def _arrays(path: Path, kinds: str) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path} is missing: give {kinds}")
    try:
        arrays = read_arrays(path)
    except InputError as error:
        raise InputError(f"{error}; give {kinds}") from None
    return {
        name: values.ravel().tolist() for name, values in arrays.items() if values.nbytes <= MAX_ARRAY_BYTES
    }
