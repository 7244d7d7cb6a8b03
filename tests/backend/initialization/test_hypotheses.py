"""A turning body is found beneath light that stands still; a body at rest stays at rest."""

import numpy as np
import pytest

from polhode.backend.initialization.hypotheses import (
    best_inliers,
    contrast,
    contrast_of_links,
    links_of_the_body,
    rotation_errors,
)
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, make_pose
from polhode.records.tracks import RelativePoses

FRAMES, STEP_RAD = 40, np.deg2rad(21.0)
TIME_S = 0.5 * np.arange(float(FRAMES))
R_NR = np.tile(np.eye(3), (FRAMES, 1, 1))


def spinning(step_rad: float = STEP_RAD) -> Array:
    """Poses (F, 4, 4) of a body that spins across the line of sight, with a little precession."""
    X_RG = [np.eye(4)]
    for k in range(FRAMES - 1):
        turn = step_rad * np.array([0.08 * np.cos(0.3 * k), 1.0, 0.08 * np.sin(0.3 * k)])
        X_RG.append(make_pose(exp_so3(turn), np.zeros(3)) @ X_RG[-1])
    return make_pose(np.array(X_RG)[:, :3, :3], np.tile([0.0, 0.0, 1.0], (FRAMES, 1)))


def links_under_light(X_RG: Array, light: int, body: int, seed: int = 0) -> tuple[RelativePoses, Bools]:
    """For each pair of frames a link at rest, one of the body where both see its side, and two wrong ones;
    with whether each is the body's. ``light`` and ``body``: their inliers."""
    rng = np.random.default_rng(seed)
    view = X_RG[:, 2, :3]
    rows: list[tuple[int, int, Array, int, bool]] = []
    for i in range(FRAMES):
        for j in range(i + 1, FRAMES):
            noise = make_pose(exp_so3(np.deg2rad(1.5) * rng.normal(size=3)), 2e-3 * rng.normal(size=3))
            angle = np.arccos(np.clip(view[i] @ view[j], -1.0, 1.0))
            right = X_RG[i] @ inverse_pose(X_RG[j])
            rows.append((i, j, noise, light, False))
            if angle < np.deg2rad(30.0):
                # a side that has come back looks the same in the same light
                inliers = (4 * light if angle < np.deg2rad(8.0) and light else body) if body else 0
                rows.append((i, j, right @ noise, inliers, True))
            for _ in range(2):
                wrong = make_pose(exp_so3(rng.uniform(-1.5, 1.5, 3)), 0.05 * rng.normal(size=3))
                rows.append((i, j, wrong, 12, False))
    kept = [row for row in rows if row[3] > 0]
    links = RelativePoses(
        np.array([row[0] for row in kept]),
        np.array([row[1] for row in kept]),
        np.array([row[2] for row in kept]),
        np.array([row[3] for row in kept]),
    )
    return links, np.array([row[4] for row in kept])


def test_a_spin_is_found_though_three_quarters_of_the_matches_stand_still() -> None:
    X_RG = spinning()
    links, right = links_under_light(X_RG, light=90, body=25)
    present = contrast_of_links(links, TIME_S, R_NR)
    assert present is None or present < 2.0
    chosen = links_of_the_body(links, TIME_S, R_NR, present)
    assert chosen is not None
    assert right[chosen].mean() > 0.95 and np.sum(chosen & right) > 0.9 * np.sum(right)
    # of the several links of a pair of frames one is chosen
    pairs = list(zip(links.i[chosen].tolist(), links.j[chosen].tolist(), strict=True))
    assert len(pairs) == len(set(pairs))
    # the camera rolls: what stands still in N turns in its images; the times are others
    roll = exp_so3(np.outer(np.deg2rad(4.0) * np.arange(FRAMES), [0.0, 0.0, 1.0]))
    X_NR = make_pose(roll, np.zeros((FRAMES, 3)))
    X_RiRj = inverse_pose(X_NR)[links.i] @ links.X_RiRj @ X_NR[links.j]
    seen = RelativePoses(links.i, links.j, X_RiRj, links.inliers)
    chosen = links_of_the_body(seen, 10.0 + 3.0 * TIME_S, roll, None)
    assert chosen is not None and right[chosen].mean() > 0.95


def test_no_course_is_chosen_for_a_body_at_rest_nor_in_place_of_a_clear_motion() -> None:
    for seed in range(4):
        at_rest, _ = links_under_light(spinning(0.0), light=90, body=0, seed=seed)
        assert links_of_the_body(at_rest, TIME_S, R_NR, None) is None
    links, _ = links_under_light(spinning(), light=0, body=80)
    present = contrast_of_links(links, TIME_S, R_NR)
    assert present is not None and present > 5.0
    assert links_of_the_body(links, TIME_S, R_NR, present) is None


def test_contrast_is_a_ratio_of_medians_over_connected_frames_and_errors_are_angles() -> None:
    X_RG = spinning()
    angle = np.rad2deg(np.arccos(np.clip(X_RG[:, 2, :3] @ X_RG[:, 2, :3].T, -1.0, 1.0)))
    inliers = np.where(angle < 15.0, 60.0, 20.0)
    assert contrast(X_RG, np.ones(FRAMES, dtype=bool), inliers) == pytest.approx(3.0)
    # no revolution is complete: no side is seen again
    assert contrast(X_RG, np.arange(FRAMES) < 10, inliers) is None
    # the best link of a pair counts, in both orders
    links = RelativePoses(np.array([0, 0]), np.array([2, 2]), np.tile(np.eye(4), (2, 1, 1)), np.array([7, 9]))
    np.testing.assert_array_equal(best_inliers(links, 3), [[0, 0, 9], [0, 0, 0], [9, 0, 0]])
    off = X_RG[0] @ inverse_pose(X_RG[5]) @ make_pose(exp_so3([0.0, 0.0, 0.3]), np.zeros(3))
    links = RelativePoses(np.array([0]), np.array([5]), off[None], np.array([9]))
    np.testing.assert_allclose(rotation_errors(links, X_RG), [0.3])
