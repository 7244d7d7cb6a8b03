"""Errors of the library, in which options of the command line have the names of arguments."""

import pytest

from polhode.runtime.argument_names import errors_name_arguments, in_words_of_python
from polhode.runtime.errors import InputError

ARGUMENTS = {"--step-s": "step_s", "-o": "output", "--frame": "frame", "--overwrite": "overwrite"}


@pytest.mark.parametrize(
    ("of_command", "of_library"),
    [
        ("--step-s 0: give seconds", "step_s=0: give seconds"),
        ("--step-s -1e-12: too short", "step_s=-1e-12: too short"),
        ("--step-s nan: no number", "step_s=nan: no number"),
        ("give a larger --step-s", "give a larger step_s"),
        ("x is a folder: -o names a file", "x is a folder: output names a file"),
        ("--frame inertial: give it", "frame='N': give it"),
        ("replace it with --overwrite", "replace it with overwrite=True"),
        ("use fewer --runtime.workers", "use fewer runtime.workers"),
        ("set --mapping.voxel-mm 8", "set mapping.voxel_mm 8"),
        ("pip install --no-deps x, a-o, pre--step-s", "pip install --no-deps x, a-o, pre--step-s"),
    ],
)
def test_options_become_arguments_and_all_else_stays(of_command: str, of_library: str) -> None:
    assert in_words_of_python(of_command, ARGUMENTS, {"overwrite"}, {"inertial": "N"}) == of_library


def test_an_error_keeps_its_kind_and_what_led_to_it() -> None:
    @errors_name_arguments({"--horizon": "horizon_s"})
    def look_ahead(horizon_s: float, members: int = 3) -> float:
        if horizon_s <= 0.0:
            raise InputError(f"--horizon {horizon_s:g}: give seconds above 0, and --members above 2")
        return horizon_s

    assert look_ahead(2.0) == 2.0
    with pytest.raises(
        InputError, match=r"^horizon_s=0: give seconds above 0, and members above 2$"
    ) as caught:
        look_ahead(0.0)
    assert isinstance(caught.value.__cause__, InputError)
