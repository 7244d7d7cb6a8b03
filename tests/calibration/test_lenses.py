"""The lens models are OpenCV's and the fisheye of the shared module, and their derivatives are right."""

import cv2
import numpy as np
import pytest

from polhode.calibration.lenses import (
    COEFFICIENTS,
    Lens,
    Model,
    normalized_by_newton,
    project,
    project_with_derivatives,
)
from polhode.calibration.start_values import normalized
from polhode.geometry import fisheye
from polhode.geometry.lie import Array
from tests.calibration.synthetic_rigs import lens

MODELS: tuple[Model, ...] = tuple(COEFFICIENTS)


def points(count: int = 40) -> Array:
    rng = np.random.default_rng(5)
    return np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), rng.uniform(0.6, 2.0, count)])


@pytest.mark.parametrize("model", ["brown5", "brown8"])
def test_pinholes_are_those_of_opencv(model: Model) -> None:
    each, p_C = lens(model), points()
    theirs = cv2.projectPoints(p_C[:, None], np.zeros(3), np.zeros(3), each.K, each.coefficients)[0]
    np.testing.assert_allclose(project(each, p_C), theirs.reshape(-1, 2), atol=1e-10)


def test_lenses_are_those_of_opencv_and_the_shared_module() -> None:
    each, p_C = lens("fisheye"), points()
    p_C[::7, 2] = -0.05
    p_C[3] = [0.0, 0.0, 1.0]
    np.testing.assert_allclose(project(each, p_C), fisheye.project(p_C, each.K, each.coefficients), atol=1e-9)
    # a point behind a pinhole and a pixel beyond its image are nan
    each = lens("brown5")
    assert np.isnan(project(each, np.array([[0.1, 0.1, -1.0]]))).all()
    folded = Lens("brown5", np.array([500.0, 500.0, 320.0, 240.0, -0.6, 0.0, 0.0, 0.0, 0.0]))
    assert np.isnan(normalized_by_newton(folded, np.array([[1200.0, 900.0]]))).all()


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_are_those_of_differences_and_rays_lead_back(model: Model) -> None:
    each, p_C, h = lens(model), points(), 1e-6
    _, by_point, by_values = project_with_derivatives(each, p_C)
    for k in range(3):
        step = h * np.eye(3)[k]
        difference = (project(each, p_C + step) - project(each, p_C - step)) / (2 * h)
        np.testing.assert_allclose(by_point[:, :, k], difference, rtol=1e-5, atol=1e-4)
    for k in range(len(each.values)):
        step = h * np.eye(len(each.values))[k]
        difference = (project(each.moved(step), p_C) - project(each.moved(-step), p_C)) / (2 * h)
        np.testing.assert_allclose(by_values[:, :, k], difference, rtol=1e-5, atol=1e-4)
    # rays of pixels lead back to the points
    each, p_C = lens(model), points()
    np.testing.assert_allclose(normalized(each, project(each, p_C)), p_C[:, :2] / p_C[:, 2:], atol=1e-8)
