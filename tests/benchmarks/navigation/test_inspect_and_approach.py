"""Plan, record and tables of the loop of inspection and approach, on synthetic poses."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

from benchmarks.navigation import approach_flights, inspect_and_approach
from benchmarks.navigation.approach_flights import (
    END_M,
    IMAGES,
    START_M,
    Flight,
    Known,
    Weights,
    as_line,
    from_line,
    planned,
    promised,
    sized,
)
from benchmarks.navigation.arrivals import (
    ATTITUDE,
    CONFIDENCE,
    POSITION,
    RATE,
    VELOCITY,
    arrival,
    errors_of_poses,
    fitted_sizes,
    leaving_open,
    promise,
    squared_distance,
    stretch,
)
from benchmarks.navigation.edge_refinement import RefinedEdges
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, inverse_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.observability_metric import motion_scale, moved
from polhode.planning.prediction import FinalEstimate, FinalState, nominal_motion
from polhode.studies.flat_metrics import as_json

SIGMA_M = 3e-3
SIZES = Weights(noise=1.0, edges=2.5, outward=3.0)


def known_and_edges() -> tuple[Known, RefinedEdges]:
    """Each segment is displaced as a whole, by as much as the mesh's sigma."""
    model = edge_model(trimesh.creation.box([0.6, 0.5, 0.35]))
    J = np.diag([1.3, 1.0, 0.8])
    sigma = np.repeat([2e-3, 3e-4, 5e-3, 3e-4, 5e-3, 2e-3], [3, 3, 3, 3, 5, 3])
    last = FinalState(
        np.array([0.0, 0.0, 2.2]),
        np.zeros(3),
        exp_so3([0.4, -0.2, 0.9]),
        np.array([0.05, 0.1, 0.03]),
        J,
        np.eye(3),
        np.zeros((5, 3, 3)),
        np.diag(sigma**2),
    )
    estimate = FinalEstimate(last, np.array([0.02, 0.0, 0.01]), 1e-10, 1e-10)
    covariance = SIGMA_M**2 * np.tile(np.eye(3), (len(model.ends_G), 2, 2))
    return Known(estimate, model.centre_G, SIGMA_M), RefinedEdges(model, covariance)


def flight(seed: int) -> Flight:
    """Poses with errors of ``SIZES``, of the views that are expected."""
    known, edges = known_and_edges()
    way = planned(known, edges, np.array([0.3, -0.2, -1.0]), seed)
    rng = np.random.default_rng(seed)
    outward_m = SIZES.outward * known.sigma_m * rng.normal()
    motion = nominal_motion(known.estimate, way.time_s)
    true = np.array([inverse_pose(a) @ b for a, b in zip(way.X_NR, motion.X_NG, strict=True)])
    found = []
    for X_RG, errors in zip(true, way.expected, strict=True):
        step = np.linalg.cholesky(sum(sized(errors, SIZES))) @ rng.normal(size=6) + errors.outward * outward_m
        found.append(moved(X_RG, step, known.centre_G))
    agreement = np.full(len(true), 0.8)
    w_G = np.einsum("ji,j->i", motion.R_NG[-1], motion.w_N[-1])
    none = np.zeros((len(true), 6))
    return Flight(known, way, np.array(found), none, way.expected, agreement, true, motion.v_N[-1], w_G)


def mean_nees(flights: list[Flight], weights: Weights) -> float:
    """Of all poses, per degree of freedom."""
    out = []
    for each in flights:
        for error, expected in zip(errors_of_poses(each), each.found, strict=True):
            noise, edges = sized(expected, weights)
            outward = weights.outward * each.known.sigma_m * expected.outward
            out.append(error @ np.linalg.solve(noise + edges + np.outer(outward, outward), error) / 6.0)
    return float(np.mean(out))


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(approach_flights, "WAYS", 2)
        return [flight(seed) for seed in range(1, 11)]


def test_a_way_leads_from_the_start_to_the_end_and_looks_at_the_target(flights: list[Flight]) -> None:
    for each in flights[:3]:
        centre = each.true_X_RG[:, :3, :3] @ each.known.centre_G + each.true_X_RG[:, :3, 3]
        assert np.allclose(centre[[0, -1], 2], [START_M, END_M], atol=1e-6)
        assert np.abs(centre[:, :2]).max() < 1e-9 and len(centre) == IMAGES


def test_the_plan_is_the_way_that_promises_least() -> None:
    known, edges = known_and_edges()
    best = planned(known, edges, np.array([0.3, -0.2, -1.0]), 1)
    X_NG = nominal_motion(known.estimate, best.time_s).X_NG
    size = motion_scale(edges.model.radius_m)

    def trace(covariance: Array) -> float:
        return float(np.sum(np.diagonal(covariance)[:6] / size**2))

    least = trace(promised(known, best, Weights(), X_NG))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(approach_flights, "WITHIN_DEG", 0.0)
        straight = planned(known, edges, np.array([0.3, -0.2, -1.0]), 1)
    assert least < trace(promised(known, straight, Weights(), X_NG))


def test_a_flight_is_the_same_after_the_record(flights: list[Flight]) -> None:
    again = from_line(json.loads(json.dumps(as_json(as_line(flights[0])))))
    assert np.array_equal(again.X_RG, flights[0].X_RG) and again.shown.all()
    assert np.array_equal(again.known.estimate.last.covariance, flights[0].known.estimate.last.covariance)
    for a, b in zip(again.found, flights[0].found, strict=True):
        assert np.allclose(a.noise, b.noise) and np.allclose(a.edges, b.edges)
        assert np.array_equal(a.outward, b.outward)


def test_sizes_are_found_from_the_errors_of_poses(flights: list[Flight]) -> None:
    found = fitted_sizes(flights, expected=False)
    assert 0.7 < found.edges / SIZES.edges < 1.4 and 0.5 < found.outward / SIZES.outward < 2.0
    assert 0.7 < mean_nees(flights, found) < 1.4
    assert mean_nees(flights, Weights(1.0, 1.0, 1.0)) > 1.5
    # poses that are far off are left out
    wild = [replace(each, X_RG=each.X_RG.copy()) for each in flights]
    for each in wild[:5]:
        each.X_RG[0] = moved(each.X_RG[0], np.array([0.1, 0.0, 0.3, 0.0, 0.5, 0.0]), each.known.centre_G)
    again = fitted_sizes(wild, expected=False)
    assert again.edges < 1.5 * found.edges
    assert np.abs(errors_of_poses(wild[0])[0]).max() > 0.2


def test_tables_say_how_many_arrived_within_the_promise(
    flights: list[Flight], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inspect_and_approach, "FACTORS", (1.0,))
    lines = [
        {"case": {"body": body, "inspection": 1, "seed": seed}, **as_json(as_line(each))}
        for body, group in (("bus", flights[:5]), ("dish", flights[5:]))
        for seed, each in enumerate(group, 1)
    ]
    lines.append({"case": {"body": "dish", "inspection": 1, "seed": 9}, "no_flight": "no mesh"})
    groups = {body: [line for line in lines if line["case"]["body"] == body] for body in ("bus", "dish")}
    judged = inspect_and_approach._judged(groups)
    inspect_and_approach._print(judged, lines)
    printed = capsys.readouterr().out
    assert "| all | 10 |" in printed and "dish 9: no flight, no mesh" in printed
    for part in inspect_and_approach.PARTS.values():
        assert sum(each.inside(part, each.promised) for each in judged) >= 8
    assert np.mean([each.metric.taken for each in judged]) > 6.0


def test_directions_that_edges_hardly_determine_are_left_open(flights: list[Flight]) -> None:
    weak = np.array([0.0, 0.0, 0.0, 0.0, 0.6, 0.8])
    noise = np.diag(np.repeat([1e-4, 1e-3], 3) ** 2) + 0.02**2 * np.outer(weak, weak)
    one = replace(flights[0], found=tuple(replace(each, noise=noise) for each in flights[0].found))
    opened = leaving_open(one).found[3]
    assert weak @ opened.noise @ weak > 0.2
    across = np.array([0.0, 0.0, 0.0, 0.0, 0.8, -0.6])
    assert np.isclose(across @ opened.noise @ across, across @ noise @ across, rtol=1e-3)
    assert np.allclose(opened.noise[:3, :3], noise[:3, :3]) and opened.edges is one.found[3].edges


def test_a_promise_is_stretched_until_enough_flights_arrive_within(flights: list[Flight]) -> None:
    arrivals = [arrival(each, each.found, SIZES) for each in flights]
    promises = [0.01 * promise(each, SIZES) for each in flights]
    factor = stretch(arrivals, promises)
    assert factor.shape == (12,) and len(set(factor.tolist())) == 4 and factor.min() > 1.0
    for part in (POSITION, ATTITUDE, VELOCITY, RATE):
        wide = [np.outer(factor, factor) * each for each in promises]
        squares = [squared_distance(a.error, b, part) for a, b in zip(arrivals, wide, strict=True)]
        assert np.isclose(max(squares), chi2.ppf(CONFIDENCE, 3))


def test_unknown_bodies_are_refused() -> None:
    with pytest.raises(InputError, match="no such body"):
        inspect_and_approach.main(bodies=("teapot",))


def test_shares_have_the_interval_of_a_binomial() -> None:
    assert inspect_and_approach._share([True] * 114 + [False] * 6) == "95% (89% to 98%)"
    assert inspect_and_approach._share([True] * 3) == "100% (29% to 100%)"
