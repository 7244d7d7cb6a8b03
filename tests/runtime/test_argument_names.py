"""Errors of the library, in which options of the command line have the names of arguments."""

import pytest

from polhode.runtime.argument_names import errors_name_arguments
from polhode.runtime.errors import InputError, RunFailure


@errors_name_arguments({"--horizon": "horizon_s"}, words={"inertial": "N"}, further=("frame",))
def fail(error: Exception, step_s: float = 1.0, overwrite: bool = False) -> None:
    raise error


@pytest.mark.parametrize(
    ("of_command", "of_library"),
    [
        ("--step-s 0: give seconds", "step_s=0: give seconds"),
        ("--step-s -1e-12: too short", "step_s=-1e-12: too short"),
        ("--step-s nan: no number", "step_s=nan: no number"),
        ("--horizon 0: give a larger --step-s", "horizon_s=0: give a larger step_s"),
        ("x is a folder: -o names a file", "x is a folder: output names a file"),
        ("--frame inertial: give it", "frame='N': give it"),
        ("replace it with --overwrite", "replace it with overwrite=True"),
        ("use fewer --runtime.workers", "use fewer runtime.workers"),
        ("set --mapping.voxel-mm 8", "set mapping.voxel_mm 8"),
        ("pip install --no-deps x, a-o, pre--step-s", "pip install --no-deps x, a-o, pre--step-s"),
    ],
)
def test_options_become_arguments_and_all_else_stays(of_command: str, of_library: str) -> None:
    for kind in (InputError, RunFailure):
        with pytest.raises(kind) as caught:
            fail(kind(of_command))
        assert str(caught.value) == of_library
        assert isinstance(caught.value.__cause__, kind) == (of_command != of_library)
