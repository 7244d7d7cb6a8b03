"""PatchAlignment finds shifts of a few hundredths of a pixel; tracks agree better on the motion once
refined."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from polhode.config.frontend_settings import Features, Frontend
from polhode.frontend.features.patches import cut_patches, rotate_affines, upright_affines
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import SurfaceFeatureMethod
from polhode.frontend.matching.matchers import SoftmaxMatcher
from polhode.frontend.matching.pairs import PairMatch
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.frontend.rectification import make_rectifier, rectified_pair
from polhode.frontend.tracks.track_refinement import (
    align_patches,
    choose_references,
    disparity_slopes,
    refine_tracks,
)
from polhode.frontend.tracks.tracks import Association, join_matches
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import exp_so3, inverse_pose, transform_points
from polhode.geometry.rigid_fit import fit_rigid
from polhode.records.dataset import open_sequence
from polhode.records.estimate import InitialMotion
from tests.frontend.feature_world import RIG, first_features, make_world

SAMPLE = Path(__file__).parents[3] / "examples" / "sample"
CONFIG = Frontend(features=Features(method="polhode"))


def _texture() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """A picture (300, 300) without anything finer than five pixels."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:300, :300]
    waves = rng.uniform(-1.2, 1.2, (30, 2))
    sum_of = sum(
        np.cos(a * u + b * v + phase) for (a, b), phase in zip(waves, rng.uniform(0, 6, 30), strict=True)
    )
    return np.asarray(120.0 + 12.0 * sum_of)


def test_alignment_finds_the_shift_in_other_light() -> None:
    image = np.clip(_texture(), 0, 255).astype(np.uint8)
    darker = np.clip(0.6 * _texture() + 30.0, 0, 255).astype(np.uint8)
    rng = np.random.default_rng(1)
    uv = rng.uniform(60, 240, (40, 2))
    affine = rotate_affines(upright_affines(np.full(40, 9.0)), rng.uniform(0, 6, 40))
    template = cut_patches(image, uv, affine)
    found = align_patches(template, darker, uv + rng.uniform(-1.2, 1.2, (40, 2)), affine)
    assert np.median(np.linalg.norm(found.uv_px - uv, axis=1)) < 0.05
    assert np.mean(np.linalg.norm(found.uv_px - uv, axis=1) < 0.1) > 0.9
    assert np.median(found.correlation) > 0.98


def test_alignment_leaves_what_has_no_texture() -> None:
    even = np.full((100, 100), 90, np.uint8)
    uv, affine = np.array([[50.0, 50.0]]), upright_affines(np.array([8.0]))
    found = align_patches(cut_patches(even, uv, affine), even, uv, affine)
    assert np.allclose(found.uv_px, uv, atol=1e-6)
    assert found.correlation[0] < 0.5


def test_slopes_of_the_disparity_are_those_of_the_plane() -> None:
    rig = RectifiedRig(467.0, 300.0, 250.0, 0.09, 640, 480, 4.0)
    n = np.array([0.3, -0.4, -0.8])
    n /= np.linalg.norm(n)
    uv = np.array([[280.0, 260.0], [281.0, 260.0], [280.0, 261.0]])
    rays = np.column_stack([(uv - [rig.cx_px, rig.cy_px]) / rig.focal_px, np.ones(3)])
    p_R = rays * (-0.5 / (rays @ n))[:, None]
    d = rig.project(p_R)[:, 2]
    slope = disparity_slopes(p_R[:1], n[None], rig)[0]
    assert np.allclose(slope, [d[1] - d[0], d[2] - d[0]], rtol=0.01)


def refined() -> tuple[list[StereoFeatures], list[StereoFeatures], Association, Association]:
    """The first three frames of the sample, before and after; motion by blind matching to the first."""
    sequence = open_sequence(SAMPLE)
    rectifier = make_rectifier(sequence.calibration)
    method, match = SurfaceFeatureMethod(CONFIG), SoftmaxMatcher(CONFIG)
    frames = [method(rectified_pair(sequence, rectifier, k), rectifier.rig) for k in range(3)]
    links, poses = [], [np.eye(4)]
    for k in range(1, 3):
        pairs = match(frames[0], frames[k]).features
        a, b = frames[0], frames[k]
        rng = np.random.default_rng(k)
        fit = ransac_rigid(a.uvd_px[pairs[:, 0]], a.p_R[pairs[:, 0]], b.p_R[pairs[:, 1]], rectifier.rig, rng)
        links.append(PairMatch(0, k, fit.X_RiRj, pairs[fit.inlier]))
        poses.append(inverse_pose(fit.X_RiRj))
    everything = frames + [first_features(frames[0], 0)] * (len(sequence) - 3)
    found = join_matches(everything, links)
    connected = np.arange(len(sequence)) < 3
    motion = InitialMotion(np.array(poses + [np.eye(4)] * (len(sequence) - 3)), connected)
    after, kept = refine_tracks(sequence, rectifier, everything, found, motion, CONFIG, 1)
    return everything, after, found, kept


def _disagreement_px(frames: list[StereoFeatures], association: Association, k: int) -> float:
    """Median distance in the image of frame k's points from those of frame 0, moved as fits them best."""
    label_0, label_k = association.landmark[0], association.landmark[k]
    i, j = np.nonzero((label_0[:, None] == label_k[None, :]) & (label_0 >= 0)[:, None])
    p, q = frames[0].p_R[i], frames[k].p_R[j]
    moved = transform_points(fit_rigid(p, q, p[:, 2] ** -4.0), q)
    return float(np.median(np.linalg.norm(RIG.project(moved)[:, :2] - RIG.project(p)[:, :2], axis=1)))


def test_refined_tracks_agree_better_on_a_motion_and_most_observations_stay() -> None:
    before, after, found, kept = refined()
    for k in range(1, 3):
        assert _disagreement_px(after, kept, k) < 0.7 * _disagreement_px(before, kept, k)
    was, stays = (np.concatenate(a.landmark[:3]) for a in (found, kept))
    assert np.all((stays == was) | (stays == -1))
    assert np.sum(stays >= 0) > 0.6 * np.sum(was >= 0)
    assert all(np.isfinite(frame.uvd_px).all() and (frame.sigma_px > 0).all() for frame in after)


def test_the_reference_of_a_landmark_is_the_view_that_faces_the_camera_most() -> None:
    seen = first_features(make_world(1).frames[0], 2)
    back = np.diag([1.0, -1.0, -1.0])
    # the first frame sees one surface aslant and the other from the front, the second the other way round
    axes = np.stack([exp_so3([0.9, 0.0, 0.0]) @ back, back])
    frames = [replace(seen, R_RS=axes), replace(seen, R_RS=axes[::-1])]
    label = np.arange(2)
    motion = InitialMotion(np.tile(np.eye(4), (2, 1, 1)), np.ones(2, bool))
    chosen = choose_references(frames, Association((label, label)), motion)
    np.testing.assert_array_equal(chosen.frame, [1, 0])
    np.testing.assert_array_equal(chosen.feature, label)


def test_features_without_axes_are_left_alone() -> None:
    sequence = open_sequence(SAMPLE)
    nothing = [first_features(make_world(1).frames[0], 0)] * len(sequence)
    association = Association(tuple(np.zeros(0, np.int64) for _ in nothing))
    motion = InitialMotion(np.tile(np.eye(4), (len(sequence), 1, 1)), np.ones(len(sequence), bool))
    after, kept = refine_tracks(
        sequence, make_rectifier(sequence.calibration), nothing, association, motion, CONFIG, 1
    )
    assert after == nothing
    assert kept is association
