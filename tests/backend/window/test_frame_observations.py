"""Landmarks eliminated as the batch solver does it; what leaves is kept whole; G may move with everything."""

import numpy as np
import pytest

from polhode.backend.problem.inertia import FORMS
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import motion_data, rig_vector
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.backend.solvers.robust_kernel import robust_gain
from polhode.backend.window.frame import (
    Frame,
    FramePoses,
    LandmarkSlots,
    ObservationModel,
    condense,
    frames_of,
    gather_observations,
    information_of,
    residuals,
)
from polhode.config.backend_settings import Backend
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SyntheticScene(frames=8, landmarks=80, detection=0.5, w_G=(0.4, 0.5, 0.45)), 3)


@pytest.fixture(scope="module")
def frames(sequence: SyntheticSequence) -> list[Frame]:
    """All frames near their true poses, each landmark kept at its number."""
    out = []
    for k, m in enumerate(frames_of(sequence.tracks)):
        x = np.concatenate([sequence.X_NG[k, :3, 3], RNG.normal(0.0, 0.01, 3), np.zeros(6)])
        R_ref = sequence.X_NG[k, :3, :3]
        out.append(Frame(k, 0.5 * k, m.X_NR, R_ref, x, m.landmark, m.uvd_px, 1.0 / m.sigma_px))
    return out


def model_of(sequence: SyntheticSequence) -> ObservationModel:
    return ObservationModel(rig_vector(sequence.tracks.rig), 3.0, 1.0)


def test_condensed_vision_is_the_batch_solvers_reduced_system(
    sequence: SyntheticSequence, frames: list[Frame]
) -> None:
    tracks = sequence.tracks
    data = motion_data(tracks, Backend())
    xi, R_inertia = FORMS["second_moments"].coordinates(np.eye(3))
    zero = np.zeros((len(frames), 3))
    reference = Iterate(
        sequence.X_NG[:, :3, 3],
        sequence.X_NG[:, :3, :3],
        zero,
        zero,
        np.zeros(3),
        xi,
        R_inertia,
        sequence.p_G,
    )
    x = reference.vector()
    x[: 12 * len(frames)].reshape(-1, 12)[:, 3:6] = [frame.x[3:6] for frame in frames]
    solver, fixed = GaussNewton(data, with_dynamics=False), linearization_point(data, reference)
    s = np.sum(solver.residuals(fixed, x)[0] ** 2, axis=1)
    # the weights without the kernel's curvature, as the window has them
    S, g, _ = solver.reduced(solver.normal_equations(fixed, x, 1.0 / (1.0 + s / 9.0), prior=False))
    at = (12 * np.arange(len(frames))[:, None] + np.arange(6)).ravel()
    S = np.tril(S) + np.tril(S, -1).T
    observations = gather_observations(frames, tracks.n_landmarks)
    condensed = condense(
        observations, FramePoses(frames), model_of(sequence), sequence.p_G[observations.slot]
    )
    np.testing.assert_allclose(condensed.S, S[np.ix_(at, at)], rtol=1e-6, atol=1e-8 * S[at, at].max())
    np.testing.assert_allclose(condensed.g, g[at], rtol=1e-6, atol=1e-8 * np.abs(g).max())


def test_what_a_frame_says_given_the_others_completes_what_they_say(
    sequence: SyntheticSequence, frames: list[Frame]
) -> None:
    model, n = model_of(sequence), sequence.tracks.n_landmarks
    observations, poses = gather_observations(frames, n), FramePoses(frames)
    p_G = sequence.p_G
    whole = condense(observations, poses, model, p_G[observations.slot])
    common = observations.common_with(3)
    H, g = information_of(3, common, poses, model, p_G[common.slot])
    others = gather_observations([f if f.number != 3 else blind(f) for f in frames], n)
    rest = condense(others, poses, model, p_G[others.slot])
    np.testing.assert_allclose(rest.S + H, whole.S, atol=1e-9 * whole.S.max())
    np.testing.assert_allclose(rest.g + g, whole.g, atol=1e-9 * np.abs(whole.g).max())
    assert np.linalg.eigvalsh(H)[0] > -1e-9 * whole.S.max()


def blind(frame: Frame) -> Frame:
    return Frame(frame.number, frame.time_s, frame.X_NR, frame.R_ref, frame.x)


def test_fixed_linearization_keeps_the_jacobian_but_not_the_residual(
    sequence: SyntheticSequence, frames: list[Frame]
) -> None:
    rig, observations = model_of(sequence).rig, gather_observations(frames, sequence.tracks.n_landmarks)
    p_G = sequence.p_G[observations.slot]
    before = FramePoses(frames)
    frames[2].fix_linearization()
    frames[2].x[:6] += 1e-3
    after = FramePoses(frames)
    frames[2].x[:6] -= 1e-3
    frames[2].linearized_at = None
    np.testing.assert_array_equal(after.A_linearized[2], before.A_linearized[2])
    assert (
        np.abs(residuals(observations, after, rig, p_G) - residuals(observations, before, rig, p_G)).max()
        > 0.1
    )


def test_landmark_steps_lead_to_the_joint_optimum(sequence: SyntheticSequence, frames: list[Frame]) -> None:
    observations = gather_observations(frames, sequence.tracks.n_landmarks)
    c = condense(observations, FramePoses(frames), model_of(sequence), sequence.p_G[observations.slot])
    step = RNG.normal(0.0, 1e-4, 6 * len(frames))
    marks = c.landmark_steps(step)
    # at the optimum of a landmark its own gradient vanishes: C step + E^T pose + h = 0
    along = np.einsum("lij,lj->li", np.linalg.inv(c.C_inv), marks) + c.h
    np.add.at(
        along, observations.landmark, np.einsum("mij,mi->mj", c.E, step.reshape(-1, 6)[observations.frame])
    )
    assert np.abs(along).max() < 1e-8 * np.abs(c.h).max()


def test_a_loose_kernel_needs_no_gain_and_a_tight_one_more() -> None:
    assert robust_gain(1e3) == pytest.approx(1.0, abs=1e-4)
    assert robust_gain(3.0) == pytest.approx(1.24, abs=0.01)


def test_more_landmarks_than_slots() -> None:
    marks = LandmarkSlots()
    slots = marks.take(np.arange(3000))
    marks.views[slots] += 2
    assert len(np.unique(slots)) == 3000
    marks.leave(slots[:10])
    np.testing.assert_array_equal(marks.find(np.arange(3000)), slots)
    assert len(marks.used) == 3000
