"""A folder of TUM's RGB-D benchmark: colour and depth images of one camera.

Today's dataset holds stereo pairs, so such a folder is recognized and refused. Depth images would be read
here: depth.txt and rgb.txt list times and files, a value of 5000 is 1 m.
"""

from pathlib import Path

from polhode.errors import InputError


def is_tum_rgbd(path: Path) -> bool:
    """Whether a folder is laid out as that benchmark's."""
    return (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()


def refuse_tum_rgbd(path: Path) -> InputError:
    """The line about it."""
    return InputError(
        f"{path}: colour and depth images of one camera (TUM RGB-D), which polhode does not use yet; give "
        "a stereo pair"
    )
