"""All checks of the answer by its measurements, one after the other (docs/checks.md)."""

import trimesh

from polhode.config.backend_settings import Backend
from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import Array, inverse_pose
from polhode.pipeline.checks.answer_checks.estimate_checks import (
    link_check,
    mesh_check,
    mirror_check,
    push_check,
    runner_up_check,
    window_check,
)
from polhode.pipeline.checks.answer_checks.model_check import model_check
from polhode.pipeline.checks.answer_checks.part_solutions import part_checks
from polhode.pipeline.checks.answer_checks.residual_checks import residual_checks, sun_check
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, attempt_checks
from polhode.run_directory.summary_schema import Check, Physics


def check_answer(
    tracks: StereoTracks,
    estimate: MotionEstimate,
    links: RelativePoses,
    config: Backend,
    online: OnlineEstimate | None,
    sun_N: Array | None,
) -> list[Check]:
    """Doubts about the motion found, from its measurements alone.

    ``online``: the causal estimate, None: there is none; sun_N (3,): unit vector towards the Sun, None:
    unknown.
    """
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    return [
        *attempt_checks(lambda: part_checks(tracks, estimate, config)),
        *attempt_checks(lambda: residual_checks(tracks, estimate)),
        *attempt_checks(lambda: [sun_check(tracks, estimate, sun_N)]),
        *attempt_checks(lambda: [link_check(links, X_RG)]),
        *attempt_checks(lambda: [mirror_check(tracks, estimate), runner_up_check(estimate)]),
        *attempt_checks(lambda: [push_check(estimate)]),
        *attempt_checks(lambda: [window_check(online, estimate)]),
    ]


def with_sun_check(
    doubts: list[Check], tracks: StereoTracks, estimate: MotionEstimate, sun_N: Array | None
) -> list[Check]:
    """The doubts with the check against the Sun made again, now that its direction is known."""
    if sun_N is None:
        return doubts
    (check,) = attempt_checks(lambda: [sun_check(tracks, estimate, sun_N)])
    return [check if each.name == CHECK_TABLE["sun"].name else each for each in doubts]


def check_surface(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    physics: Physics | None,
    sun_N: Array | None,
) -> list[Check]:
    """Doubts about the motion found, from the surface that it gives; as ``check_answer``."""
    return [
        *attempt_checks(lambda: [mesh_check(physics)]),
        *attempt_checks(lambda: [model_check(sequence, rectifier, tracks, estimate, mesh, sun_N)]),
    ]
