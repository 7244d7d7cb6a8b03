"""``polhode doctor``: whether this installation works, on this machine."""

import platform
import resource
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from time import perf_counter
from typing import Any

from packaging.requirements import Requirement

from polhode.cli.answer import Answer
from polhode.cli.options import Command
from polhode.runtime.console import announce, choose_progress
from polhode.runtime.errors import one_line

MEMINFO = Path("/proc/meminfo")
CGROUP_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


class DoctorCommand(Command):
    """Check the installation: packages, memory, optional parts, and a self-test of some seconds.

    Exit code 0: it works; 1: something that polhode needs is missing or does not work. Optional parts are
    listed with what they are for and the command that adds them; none of them is needed. The first call after
    an installation takes longer, because functions are compiled.
    """

    skip_test: bool = False
    """Leave out the self-test."""

    def execute(self) -> Answer:
        """Look, test, and say what was found, each as soon as it is."""
        from polhode.runtime.optional_parts import OPTIONAL_PARTS

        facts: dict[str, Any] = {}
        for found, line in _facts():
            facts |= found
            announce(line)
        announce("\nOptional parts, none of which is needed:")
        parts = []
        for part in OPTIONAL_PARTS:
            packages, missing = list(part.modules.values()), part.missing
            state = f"missing: {', '.join(missing)}; {part.how_to_install}" if missing else "installed"
            announce(f"  {', '.join(packages)} ({state})\n      for {part.purpose}")
            about = {"purpose": part.purpose, "install": part.how_to_install}
            parts.append({"extra": part.extra, "packages": packages, "missing": missing, **about})
        checks = []
        if not self.skip_test:
            announce("\nSelf-test:")
            for each in self_test():
                state = "ok  " if each["holds"] else "FAIL"
                announce(f"  {state} {each['name']:12s} {each['seconds']:4.1f} s  {each['finding']}")
                checks.append(each)
        wrong = [
            *facts["wrong_packages"],
            *(f"{each['name']}: {each['finding']}" for each in checks if not each["holds"]),
        ]
        works = "what polhode needs is installed" if self.skip_test else "polhode works here"
        return Answer(
            f"doctor: {len(wrong)} faults" if wrong else f"doctor: {works}",
            figures={**facts, "optional_parts": parts, "self_test": checks},
            failure=f"this installation does not work: {'; '.join(wrong)}" if wrong else None,
        )


def _facts() -> Iterator[tuple[dict[str, Any], str]]:
    """The machine and the installation: figures, and a line about them, one after the other."""
    from polhode.runtime.code_cache import code_cache
    from polhode.runtime.optional_parts import PACKAGE
    from polhode.runtime.processes import worker_count

    own = version("polhode")
    yield {"version": own, "installed_in": PACKAGE}, f"polhode {own} in {PACKAGE}"
    python = (
        f"{platform.python_implementation()} {platform.python_version()} on {platform.platform(terse=True)}"
    )
    yield {"python": python}, f"Python         {python}"
    wrong = wrong_packages()
    packages = "; ".join(wrong) or "all that polhode needs, in versions that it accepts"
    yield {"wrong_packages": wrong}, f"packages       {packages}"
    processors = worker_count(0)
    line = f"processors     {processors}: as many parallel processes (--runtime.workers)"
    yield {"processors": processors}, line
    usable_gib, free_gib = memory_gib()
    text = "unknown" if usable_gib is None else f"{usable_gib:.1f} GiB"
    if free_gib is not None:
        # a run of the sample takes some 1.3 GiB in all its processes
        little = ": little for a run; close other programs, or use fewer --runtime.workers"
        text += f", {free_gib:.1f} GiB of it free{little if free_gib < 2.0 else ''}"
    yield {"memory_gib": usable_gib, "free_memory_gib": free_gib}, f"memory         {text}"
    cache = code_cache(PACKAGE / "geometry" / "lie.py")
    kept = cache or "none: functions are compiled in every run; set NUMBA_CACHE_DIR"
    yield {"code_cache": cache}, f"code cache     {kept}"


def wrong_packages() -> list[str]:
    """Packages that polhode requires and that are missing, or too old, each in words."""
    found = []
    for requirement in map(Requirement, requires("polhode") or ()):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            found.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            found.append(f"{requirement.name} {installed} does not meet {requirement.specifier}")
    return found


def memory_gib() -> tuple[float | None, float | None]:
    """(Usable at all, free now) [GiB]: of the machine, of the container, or by ulimit -v; None: not known."""
    known = {}
    if MEMINFO.is_file():
        for line in MEMINFO.read_text().splitlines():
            name, _, value = line.partition(":")
            known[name] = 1024 * int(value.split()[0])
    limits = [known["MemTotal"]] if known else []
    limits += [
        int(text) for path in CGROUP_LIMITS if path.is_file() and (text := path.read_text().strip()).isdigit()
    ]
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    limits += [soft] if soft != resource.RLIM_INFINITY else []
    free = min(known["MemAvailable"], *limits) / 2**30 if known else None
    return min(limits) / 2**30 if limits else None, free


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
    from polhode.runtime.progress import Silent
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
    "networks": network_check,
    "rendering": rendering_check,
    "estimation": estimation_check,
    "processes": process_check,
}
"""Each raises an exception, or returns what it found in words."""


def self_test() -> Iterator[dict[str, Any]]:
    """All checks, one after the other; one that fails does not end the test."""
    with choose_progress().stage("self-test", len(CHECKS)) as advance:
        for name, check in CHECKS.items():
            start = perf_counter()
            try:
                holds, finding = True, check()
            except Exception as error:  # noqa: BLE001  whatever is wrong with the installation is a finding
                holds, finding = False, one_line(f"{type(error).__name__}: {error}")
            yield {"name": name, "holds": holds, "finding": finding, "seconds": perf_counter() - start}
            advance()
