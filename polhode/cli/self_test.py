"""The self-test of ``polhode doctor``: a small piece of real work for each part that an installation needs.

Every check raises an exception, or returns what it found in words.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from polhode.runtime.errors import one_line
from polhode.runtime.progress import Progress, Silent


@dataclass(frozen=True)
class Check:
    """One check and how it went."""

    name: str
    holds: bool
    finding: str
    seconds: float


def code_cache_check() -> str:
    """Compiled loops are kept between runs."""
    from pathlib import Path

    import polhode.geometry.lie
    from polhode.runtime.code_cache import code_cache

    folder = code_cache(Path(polhode.geometry.lie.__file__))
    if folder is None:
        raise RuntimeError("no folder for compiled code is writable by you alone: set NUMBA_CACHE_DIR")
    return f"compiled code is kept in {folder}"


def rendering_check() -> str:
    """The simulator renders an image of a small scene: ray casting, shading, sensor."""
    from polhode.config import Scene
    from polhode.simulation.dataset.frame_renderer import FrameRenderer
    from polhode.simulation.dataset.plan import plan_sequence

    settings: dict[str, Any] = {"frames": 1, "truth_horizon_s": 0, "motion": {"position_m": [0.04, 0.0, 0.6]}}
    settings["rig"] = {"width_px": 48, "height_px": 36, "focal_px": 35.0}
    settings |= {"light": {"earth": 0.0}, "render": {"samples": 1, "bounces": 0}}
    image, picture = FrameRenderer(plan_sequence(Scene.model_validate(settings), 0)).render_image(0, 0)
    covered = float((picture.covered > 0.5).mean())
    if not 0.02 < covered < 0.98 or not image.max() > image.min():
        raise RuntimeError(f"the target covers {covered:.0%} of a rendered image")
    return f"an image of {image.shape[1]}x{image.shape[0]} px was rendered"


def estimation_check() -> str:
    """The back end estimates a simulated tumble from a cold start; the answer is IPOPT's."""
    import numpy as np

    from polhode.backend import estimate_motion, initialize_motion
    from polhode.config import Backend
    from polhode.simulation.monte_carlo import SyntheticScene, generate

    tumble = SyntheticScene(
        frames=16, landmarks=80, detection=0.5, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9])
    )
    sequence, config = generate(tumble, seed=1), Backend()
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    found = estimate_motion(sequence.tracks, initial, config, Silent())
    if not found.solver.converged:
        raise RuntimeError("the solver did not converge on a simulated tumble")
    error = np.abs(np.linalg.norm(found.w_P, axis=1) - np.linalg.norm(sequence.truth.w_P, axis=1)).max()
    if not error < 0.02:
        raise RuntimeError(f"the rate of a simulated tumble is wrong by {error:.3g} rad/s")
    return f"{found.solver.name} solved a simulated tumble; the rate is right within {error:.1g} rad/s"


def network_check() -> str:
    """torch evaluates the shipped descriptor network."""
    import torch

    from polhode.frontend.networks.descriptor import PATCH_PX, DescriptorNet
    from polhode.frontend.networks.weights import load_weights, shipped_path

    network = DescriptorNet()
    load_weights(network, shipped_path("descriptor"))
    generator = torch.Generator().manual_seed(0)
    with torch.inference_mode():
        found = network(255.0 * torch.rand((4, 1, PATCH_PX, PATCH_PX), generator=generator))
    if not torch.allclose(found.descriptor.norm(dim=1), torch.ones(4), atol=1e-3):
        raise RuntimeError("the shipped network gives descriptors that are not of unit length")
    return f"torch {torch.__version__} evaluated the shipped network"


def process_check() -> str:
    """Work is passed to other processes, and back."""
    from polhode.runtime.processes import in_order

    if list(in_order(abs, [-1, 2], 2)) != [1, 2]:
        raise RuntimeError("other processes give wrong results")
    return "two processes did work and passed it back"


CHECKS: dict[str, Callable[[], str]] = {
    "code cache": code_cache_check,
    "networks": network_check,
    "rendering": rendering_check,
    "estimation": estimation_check,
    "processes": process_check,
}


def self_test(progress: Progress) -> Iterator[Check]:
    """All checks, one after the other; one that fails does not end the test."""
    with progress.stage("self-test", len(CHECKS)) as advance:
        for name, check in CHECKS.items():
            start = perf_counter()
            try:
                holds, finding = True, check()
            except Exception as error:  # noqa: BLE001  whatever is wrong with the installation is a finding
                holds, finding = False, one_line(f"{type(error).__name__}: {error}")
            yield Check(name, holds, finding, perf_counter() - start)
            advance()
