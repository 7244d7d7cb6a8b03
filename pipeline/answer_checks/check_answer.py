"""All checks of the answer by its measurements, one after the other (docs/checks.md)."""

import logging
from collections.abc import Callable, Iterable

import numpy as np
import trimesh

from polhode.config.backend_settings import Backend
from polhode.dataset import StereoSequence
from polhode.frontend.rectification import Rectifier
from polhode.lie import Array, inverse_pose
from polhode.pipeline.answer_checks.links_check import links_check
from polhode.pipeline.answer_checks.mesh_check import mesh_check
from polhode.pipeline.answer_checks.model_check import model_check
from polhode.pipeline.answer_checks.parts_check import parts_checks
from polhode.pipeline.answer_checks.push_check import push_check
from polhode.pipeline.answer_checks.residual_check import residual_checks
from polhode.pipeline.answer_checks.sun_check import SUN_CHECK, sun_check
from polhode.pipeline.answer_checks.twins_check import twins_checks
from polhode.pipeline.answer_checks.window_check import window_check
from polhode.pipeline.run_directory.summary_schema import Check, Physics, not_made
from polhode.records import MotionEstimate, OnlineEstimate, RelativePoses, StereoTracks

_log = logging.getLogger(__name__)


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
    unknown. An error in a check does not cost the run, which is doubted for it.
    """
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    steps: tuple[Callable[[], list[Check]], ...] = (
        lambda: parts_checks(tracks, estimate, config),
        lambda: residual_checks(tracks, estimate),
        lambda: [sun_check(tracks, estimate, sun_N)],
        lambda: [links_check(links, X_RG)],
        lambda: twins_checks(tracks, estimate),
        lambda: [push_check(estimate)],
        lambda: [window_check(online, estimate)],
    )
    return _made(steps)


def with_sun_check(
    doubts: list[Check], tracks: StereoTracks, estimate: MotionEstimate, sun_N: Array | None
) -> list[Check]:
    """The doubts with the check against the Sun made again, now that its direction is known."""
    if sun_N is None:
        return doubts
    made = _made((lambda: [sun_check(tracks, estimate, sun_N)],))
    return [made[0] if each.name == SUN_CHECK else each for each in doubts]


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
    return _made((
        lambda: [mesh_check(physics)],
        lambda: [model_check(sequence, rectifier, tracks, estimate, mesh, sun_N)],
    ))  # fmt: skip


def _made(steps: Iterable[Callable[[], list[Check]]]) -> list[Check]:
    found: list[Check] = []
    for step in steps:
        try:
            with np.errstate(invalid="ignore", divide="ignore"):
                found.extend(step())
        except (ArithmeticError, LookupError, ValueError, MemoryError) as error:
            _log.debug("a check of the answer ended with an error", exc_info=True)
            found.append(not_made(error))
    for check in found:
        if check.reason:
            _log.warning(check.reason)
    return found
