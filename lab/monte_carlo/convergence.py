"""Does a cold start end at the truth, and does it report what is undetermined? Random bodies and spins.

    python -m lab.monte_carlo.convergence [--scenes 480] [--workers 2] [--short] [--record FILE]

Two of three scenes are any body with any spin; the others are hard to tell: nearly a pure spin, nearly equal
moments, slow, or short. Each has 1 px or 0.3 px of noise, 5 % gross errors, 10 % wrong relative poses; the
process noise is estimated.

A quantity is wrong when its error exceeds five of the standard deviations that were stated and a tolerance
(1 mm, 0.02 of a ratio, 2 degrees). "converge": of the scenes in which the information at the truth determines
every quantity, those in which none is wrong. "falsely": quantities called determined, and wrong.
"""

import time
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation
from tyro.conf import arg

from lab.command import RECORDS, Record, Short, Workers, command
from lab.monte_carlo.bound import cold_start, constants_errors, determined_at_truth
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array
from polhode.records.estimate import MotionEstimate
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import RPM, SyntheticScene, generate, random_scene

RECORD = RECORDS / "convergence"
KINDS = (*["any"] * 8, "spin", "equal moments", "slow", "short")
NAMES = ("com_x", "com_y", "com_z", "k1", "k2", "axes_x", "axes_y", "axes_z")
TOLERANCE = np.array([1e-3, 1e-3, 1e-3, 0.02, 0.02, *[np.deg2rad(2.0)] * 3])
SIGMAS = 5.0
SHORT_SCENES = 2


def main(
    scenes: Annotated[int, arg(help="Random scenes.")] = 480,
    workers: Workers = 2,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the table and the seeds that went wrong."""
    seeds = range(SHORT_SCENES if short else scenes)
    print_tables(complete(record, [{"seed": seed} for seed in seeds], measure, workers))


def scene_of(seed: int) -> tuple[str, SyntheticScene]:
    """Kind and scene of a seed: 60 frames, 600 landmarks, unless short."""
    kind, rng = KINDS[seed % len(KINDS)], np.random.default_rng([seed, 91])
    noise = float(rng.choice([0.3, 1.0]))
    psd = 10.0 ** rng.uniform(-9.0, -7.0)
    common = {"frames": 60, "landmarks": 600, "detection": 0.35, "station_keeping": True}
    trouble = {"outliers": 0.05, "wrong_pairs": 0.1, "accel_psd": psd, "torque_psd": psd}
    scene = random_scene(seed, sigma_uv_px=noise, sigma_d_px=noise, **common, **trouble)
    second = np.exp(rng.uniform(-0.8, 0.8, 3))
    if kind == "equal moments":
        second[1] = second[0] * (1.0 + 10.0 ** rng.uniform(-4.0, -0.7))
    R = np.asarray(Rotation.random(rng=rng).as_matrix())
    scene = replace(scene, J_G=R @ np.diag(second.sum() - second) @ R.T)
    if kind == "spin":
        return kind, _spin(scene, R, rng)
    if kind == "slow":
        w = np.array(scene.w_G) * rng.uniform(0.05, 0.5)
        return kind, replace(scene, w_G=tuple(w.tolist()))
    if kind == "short":
        return kind, replace(scene, frames=int(rng.integers(6, 18)))
    return kind, scene


def _spin(scene: SyntheticScene, axes: Array, rng: np.random.Generator) -> SyntheticScene:
    """The same body spun about one of its axes (columns), but for a small wobble."""
    wobble = 10.0 ** rng.uniform(-4.0, -0.7)
    direction = axes[:, rng.integers(3)] + wobble * rng.normal(size=3)
    w = direction / np.linalg.norm(direction) * rng.uniform(3.0, 12.0) * RPM
    return replace(scene, w_G=tuple(w.tolist()))


def measure(case: Case) -> Case:
    """Errors, stated standard deviations and verdicts of one scene."""
    kind, scene = scene_of(case["seed"])
    sequence = generate(scene, case["seed"])
    config = Backend(solver="gauss_newton", systematic_px=(0.0, 0.0, 0.0), light_px=0.0)
    given = Backend(accel_psd=scene.accel_psd, torque_psd=scene.torque_psd)
    known = determined_at_truth(sequence, given)
    start = time.perf_counter()
    try:
        initial, estimate = cold_start(sequence, config)
    except RunFailure as failure:
        return {"kind": kind, "failure": str(failure), "determined_at_truth": known}
    return {
        "kind": kind,
        "errors": constants_errors(estimate, sequence).tolist(),
        "sigma": stated_sigma(estimate),
        "determined_at_truth": known,
        "connected": int(initial.connected.sum()),
        "converged": estimate.solver.converged,
        "runner_up": estimate.solver.runner_up,
        "torque_psd": [scene.torque_psd, estimate.noise.torque_psd],
        "noise_px": scene.sigma_uv_px,
        "seconds": round(time.perf_counter() - start, 2),
    }


def stated_sigma(estimate: MotionEstimate) -> list[float | None]:
    """(8,) standard deviations of NAMES [m, 1, rad]; None: not determined."""
    return [float(s) if np.isfinite(s) else None for s in estimate.mass.identifiable.sigma]


def wrong(line: Case) -> Array:
    """(8,) the quantities that are called determined, and wrong."""
    sigma = np.array([np.inf if s is None else s for s in line["sigma"]])
    error = np.abs(line["errors"])
    return np.asarray((error > SIGMAS * sigma) & (error > TOLERANCE))


def missed(line: Case) -> bool:
    """Everything is determined, but something is wrong or was reported as undetermined."""
    if "failure" in line:
        return True
    reported = all(s is not None for s in line["sigma"])
    return bool(wrong(line).any()) or not (reported or np.all(np.abs(line["errors"]) < SIGMAS * TOLERANCE))


def print_tables(lines: list[Case]) -> None:
    """One row for each kind of scene, then what went wrong."""
    head = "scenes | number | determined at the truth | of them converge | called determined | falsely"
    print_table(head, (_row(kind, lines) for kind in (*dict.fromkeys(KINDS), "all")))
    print_failures(lines)


def _row(kind: str, lines: list[Case]) -> list[object]:
    some = [line for line in lines if kind in ("all", line["kind"])]
    known = [line for line in some if all(line["determined_at_truth"])]
    converge = sum(not missed(line) for line in known)
    verdicts = [sigma is not None for line in some if "failure" not in line for sigma in line["sigma"]]
    false = sum(int(wrong(line).sum()) for line in some if "failure" not in line)
    share = f"{converge} ({converge / len(known):.1%})" if known else "-"
    return [kind, len(some), len(known), share, f"{sum(verdicts)} of {8 * len(some)} quantities", false]


def print_failures(lines: list[Case]) -> None:
    """A line for each run that failed, and for each quantity that is wrong or falsely undetermined."""
    for line in lines:
        case = line["case"]
        name = (
            f"seed {case['seed']} ({line['kind']})" if len(case) == 1 else ", ".join(map(str, case.values()))
        )
        if "failure" in line:
            print(f"{name}: {line['failure']}")
        elif wrong(line).any():
            for n in np.flatnonzero(wrong(line)):
                how = "" if line["determined_at_truth"][n] else "not "
                print(
                    f"{name}: {NAMES[n]} off by {line['errors'][n]:.3g}, "
                    f"stated {line['sigma'][n]:.2g}, {how}determined at the truth"
                )
        elif all(line["determined_at_truth"]) and missed(line):
            lost = [name for name, sigma in zip(NAMES, line["sigma"], strict=True) if sigma is None]
            print(f"{name}: reported as undetermined though determined: {', '.join(lost)}")


if __name__ == "__main__":
    command(main)
