"""A centre of mass outside of any body of this size is in doubt; one that is a little off is not."""

import numpy as np
import pytest

from polhode.pipeline.answer_checks.estimate_checks import mesh_check
from polhode.pipeline.run_directory.summary_schema import Physics


def physics(offset_m: float | None, sigma_m: float | None = 1e-3) -> Physics:
    return Physics(
        words=[],
        volume_m3=8e-3,
        com_uniform_G=(0.0, 0.0, 0.0),
        com_offset_G=None if offset_m is None else (0.0, offset_m, 0.0),
        com_offset_sigma_m=sigma_m,
        R_GP_uniform=np.eye(3),
        axes_angle_deg=None,
        axes_angle_sigma_deg=None,
        k1_uniform=0.1,
        k2_uniform=0.1,
        k1_difference=None,
        k2_difference=None,
    )


def test_an_offset_counts_by_the_size_and_its_sigma() -> None:
    little = mesh_check(physics(0.023))
    assert little.value == pytest.approx(10.0) and little.reason == ""
    assert "no body of this surface" in mesh_check(physics(0.21)).reason
    assert mesh_check(physics(0.21, sigma_m=0.05)).reason == ""


def test_without_an_offset_the_check_is_not_possible() -> None:
    assert mesh_check(None).value is None
    assert mesh_check(physics(None)).value is None
    assert mesh_check(physics(0.2, sigma_m=None)).value is None
