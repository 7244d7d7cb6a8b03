"""What is counted of planned and straight approaches."""

from typing import Any

import numpy as np
import pytest

from benchmarks.edges.best_trajectory import START_N, tumbling
from benchmarks.edges.planned_approaches import CAPPED, Flight, approach, table_of
from benchmarks.edges.trajectory_optimization import CameraPathTask, min_range, path_metric, straight_path
from benchmarks.edges.views import edge_body, edge_rig
from polhode.lie import exp_so3
from polhode.planning.edges.edge_model import edge_model


def line(straight: list[float], planned: list[float] | None, seed: int = 0) -> dict[str, Any]:
    def way(error: list[float]) -> dict[str, Any]:
        return {"error": error, "expected": [2.0 * each for each in error], "delta_v_m_s": 0.1 * len(error)}

    return {
        "case": {"body": "house", "seed": seed},
        "straight": way(straight),
        "planned": None if planned is None else way(planned),
    }


def test_ratios_are_of_medians_and_of_means_of_capped_errors() -> None:
    flight = Flight.of(line([0.002, 0.004, 50.0], [0.001, 0.001, 0.004]))
    assert flight.found
    assert flight.ratio_of_medians == pytest.approx(0.25) and flight.promised == pytest.approx(0.25)
    assert flight.ratio_of_means == pytest.approx(0.006 / (0.006 + CAPPED))


def test_without_a_path_the_straight_one_is_flown() -> None:
    flight = Flight.of(line([0.002, 0.004, 0.006], None))
    assert not flight.found
    assert flight.ratio_of_medians == flight.ratio_of_means == flight.promised == 1.0


def test_rows_have_geometric_means_with_bands_and_count_what_is_better() -> None:
    shares = (0.25, 0.5, 1.0, 2.0)
    flights = [Flight.of(line([0.004] * 3, [0.004 * each] * 3, k)) for k, each in enumerate(shares)]
    first, everything = table_of([*flights, Flight.of(line([0.004] * 3, None))])
    assert first[0] == "house" and everything[0] == "all" and first[1:] == everything[1:]
    assert first[1:3] == ["5", "1"] and "2 of 5" in first
    mean = np.exp(np.mean(np.log([*shares, 1.0])))
    ratio = first[7]
    assert ratio.startswith(f"{mean:.2f} (")
    low, high = (float(each) for each in ratio[ratio.index("(") + 1 : -1].split(" to "))
    assert min(shares) < low < mean < high < max(shares)


def test_errors_on_images_are_near_what_is_expected_of_the_views() -> None:
    target, rig = edge_body("block"), edge_rig()
    model = edge_model(target.mesh)
    estimate = tumbling(target.mesh, np.array([0.01, 0.0, 0.03]), exp_so3(np.array([0.4, 0.3, 0.1])))
    near = min_range(model, rig) + 0.02
    task = CameraPathTask(START_N, 60.0, 2, 0.01, (near, 4.3), 0.15, 0.1, sun_N=np.array([0.5, 0.2, -0.8]))
    seen = path_metric(model, rig, estimate, task, straight_path(model, estimate, task))
    found = approach(target, model, rig, seen, {"seed": 1, "images": 2})
    assert found["range_m"] == pytest.approx([4.0, near], abs=1e-3)
    expected = np.array(found["expected"])
    assert np.all(expected > 1e-5) and np.all(np.array(found["error"]) < 6.0 * expected)
