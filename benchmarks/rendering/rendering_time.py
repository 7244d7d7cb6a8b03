"""Time of a stereo pair against rays a pixel, bounces and faces, on one core.

Run: ``python -m benchmarks.rendering.rendering_time [--short]``. Prints Markdown. A pair: both images of
640x480 px from the first ray to the PNG on disk, motion blur and sensor included; seconds of processor time,
the median over frames that follow each other. Ray casting: the share of that time in embree and in what turns
its answers into hits. Set-up: the body's probes and compiled code, once per process. The first table has the
replica of Test Session 38; the second a lumpy ball of more and more faces in its place.
"""

import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.command import ROOT, Short, command
from polhode.config.loader import load_config
from polhode.config.scene_settings import Render, Scene
from polhode.dataset_writer import image_path
from polhode.simulation.bodies import Body
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.surface.materials import REGOLITH
from polhode.simulation.surface.noise import fractal

CONFIG = ROOT / "configs" / "ts38.yaml"
SAMPLES = (1, 4, 9, 16)
SUBDIVISIONS = (3, 5, 6, 7)
FRAMES = 5
HEAD = "| faces | rays per pixel | bounces | s per pair | of which ray casting | set-up s |\n|" + "---:|" * 6


@dataclass(frozen=True)
class Timing:
    """What one scene takes."""

    faces: int
    samples: int
    bounces: int
    pair_s: float
    casting: float
    """Share of ``pair_s``"""
    set_up_s: float

    def row(self) -> str:
        """A line of the table."""
        return (
            f"| {self.faces:,} | {self.samples} | {self.bounces} | {self.pair_s:.2f} | "
            f"{100 * self.casting:.0f} % | {self.set_up_s:.1f} |"
        )


def main(short: Short = False) -> None:
    """Print both tables."""
    loaded = load_config(CONFIG)
    assert loaded.scene is not None
    scene, seed = loaded.scene, loaded.seed
    print(f"{machine()}\n\nTest Session 38\n\n{HEAD}")
    for samples in (4,) if short else SAMPLES:
        for bounces in (0, 1):
            print(measure(_plan(scene, seed, samples, bounces), 2 if short else FRAMES).row(), flush=True)
    print(f"\nA lumpy ball\n\n{HEAD}")
    plan = _plan(scene, seed, 4, 1)
    for subdivisions in SUBDIVISIONS[:2] if short else SUBDIVISIONS:
        print(measure(replace(plan, body=lumpy_ball(subdivisions)), 2 if short else FRAMES).row(), flush=True)


def measure(plan: SequencePlan, frames: int) -> Timing:
    """Render a frame to warm up and ``frames`` more of a plan."""
    with tempfile.TemporaryDirectory() as folder, _stopwatch() as casting:
        mav0 = Path(folder)
        for index in range(2):
            image_path(mav0 / f"cam{index}", 0).parent.mkdir(parents=True)
        start = time.process_time()
        renderer = FrameRenderer(plan)
        renderer.write_pair(0, mav0)
        first_s = time.process_time() - start
        pairs_s, casts_s = np.empty((2, frames))
        for k in range(frames):
            before, start = casting.seconds, time.process_time()
            renderer.write_pair(k + 1, mav0)
            pairs_s[k], casts_s[k] = time.process_time() - start, casting.seconds - before
    pair_s, render = float(np.median(pairs_s)), plan.scene.render
    share = float(np.median(casts_s / pairs_s))
    return Timing(len(plan.body.mesh.faces), render.samples, render.bounces, pair_s, share, first_s - pair_s)


def lumpy_ball(subdivisions: int) -> Body:
    """A ball of 0.24 m under regolith with lumps down to the size of its faces."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.12)
    p_G = np.asarray(mesh.vertices)
    count = len(p_G)
    lumps = fractal(p_G, np.full(count, 0.08), np.full(count, 5, dtype=np.int64))
    mesh.vertices = p_G * (1.0 + 0.15 * lumps)[:, None]
    return assemble([Part(mesh, REGOLITH)])


def machine() -> str:
    """Processor, Python and system in a line."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if sys.platform == "linux" else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    name = names[0] if names else platform.processor() or platform.machine()
    return f"One core of {name}, Python {platform.python_version()}, {platform.system()}."


def _plan(scene: Scene, seed: int, samples: int, bounces: int) -> SequencePlan:
    render = Render.model_validate({"samples": samples, "bounces": bounces})
    sensor = scene.sensor.model_copy(update={"dropped_frames": (), "drop_probability": 0.0})
    update = {"frames": FRAMES + 1, "truth_horizon_s": 0.0, "render": render, "sensor": sensor}
    return plan_sequence(scene.model_copy(update=update), seed)


@dataclass
class _Casting:
    seconds: float = 0.0


@contextmanager
def _stopwatch() -> Iterator[_Casting]:
    """Counts the time in the ray caster's methods while it is open."""
    total = _Casting()

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            start = time.process_time()
            try:
                return method(*args, **kwargs)
            finally:
                total.seconds += time.process_time() - start

        return call

    kept = {name: getattr(RayCaster, name) for name in ("first_hits", "lit", "meets")}
    try:
        for name, method in kept.items():
            setattr(RayCaster, name, timed(method))
        yield total
    finally:
        for name, method in kept.items():
            setattr(RayCaster, name, method)


if __name__ == "__main__":
    command(main)
