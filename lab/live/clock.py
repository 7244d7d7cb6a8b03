"""Live states when the clock jumps, when nothing happens, when something pushes: which are said to be right.

    python -m lab.live.clock [--seeds 40] [--workers 1] [--short] [--record FILE]

Synthetic tracks through the sliding window, without images: ``seeds`` sequences, over the motions of
``lab.monte_carlo.accuracy``, whose stamps jump at some frame by 0.05 to 10 s (uniform in the logarithm, both
signs) and stay so; the same ones without a jump; a quarter as many with an impact of 0.25 s or a push of 3 s.
A state is wrong if a component of position or velocity, or the size of the rate, is more than five of its
sigmas off the truth, its axes are if one of attitude or rate along P is. Counted are states that are said to
be consistent, from the second pair after the event on.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from lab.command import RECORDS, Record, Seeds, Short, Workers, command
from lab.monte_carlo.accuracy import MOTIONS
from lab.monte_carlo.disturbances import FREE, UNKNOWN
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.backend.window import OnlineState, SlidingWindow, frames_of
from polhode.config.backend_settings import Backend, Window
from polhode.geometry.lie import log_so3
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.simulation.monte_carlo import SyntheticSequence, generate

RECORD = RECORDS / "clock"
AFTER = 25
"""Pairs that follow the event."""


def main(seeds: Seeds = 40, workers: Workers = 1, short: Short = False, record: Record = RECORD) -> None:
    """Measure what the record lacks, print the table."""
    numbers = {"jump": 1} if short else {"jump": seeds, "none": seeds, "push": seeds // 4}
    cases: list[Case] = [{"event": e, "seed": seed} for e, n in numbers.items() for seed in range(n)]
    lines = complete(record, cases, measure, workers)
    counted = ("wrong", "wrong_axes", "retimed", "open", "uncertain", "pairs", "alarms")
    of = {event: [line for line in lines if line["case"]["event"] == event] for event in numbers}
    rows = [[e, len(of[e]), *(sum(line[name] for line in of[e]) for name in counted)] for e in numbers]
    found = "wrong states | wrong axes | re-timed | a step left open | a pair uncertain"
    print_table(f"event | sequences | {found} | pairs before | of them uncertain", rows)


def measure(case: Case) -> Case:
    """One sequence."""
    rng, seed = np.random.default_rng([case["seed"], 52]), case["seed"]
    at, size_s = int(rng.integers(12, 60)), float(np.exp(rng.uniform(np.log(0.05), np.log(10.0))))
    scene, jump_s = MOTIONS[list(MOTIONS)[seed % len(MOTIONS)]], size_s * (-1) ** seed
    n_frames = at + AFTER + int(max(-jump_s, 0.0) / scene.dt_s)
    if case["event"] == "push":
        pushes = UNKNOWN[list(UNKNOWN)[1 + seed % 2]]
        at, scene, n_frames = int(pushes[0][0] / FREE.dt_s) + 1, replace(FREE, pushes=pushes), FREE.frames
    jump_ns = round(jump_s * 1e9) if case["event"] == "jump" else 0
    sequence = generate(replace(scene, frames=n_frames, links=False), 5000 + seed)
    window = SlidingWindow(sequence.tracks.rig, Backend(window=Window(solver="gauss_newton")))
    latest_ns, pairs = -1, dict[int, Any]()
    for k, m in enumerate(frames_of(sequence.tracks)):
        stamp_ns = m.timestamp_ns + (jump_ns if k >= at else 0)
        if stamp_ns > latest_ns:
            latest_ns, state = stamp_ns, window.add(replace(m, timestamp_ns=stamp_ns))
            off = deviation(sequence, k, state, window.sigma_rate)
            pairs[k] = off, window.judgement.consistent, window.judgement.reason
    after, before = [k for k in pairs if k >= at], [k for k in pairs if 6 <= k < at]
    off = {str(k): pairs[k][0] for k in after[1:] if pairs[k][1]}
    return {
        "jump_s": jump_ns * 1e-9,
        "wrong": any(each[0] > 5.0 for each in off.values()),
        "wrong_axes": any(each[1] > 5.0 for each in off.values()),
        "off": off,
        "retimed": any(pairs[k][1] and "re-timed" in pairs[k][2] for k in after),
        "open": any(pairs[k][1] and "left open" in pairs[k][2] for k in after),
        "uncertain": any(not pairs[k][1] for k in after),
        "pairs": len(before),
        "alarms": sum(not pairs[k][1] for k in before),
        "reasons": [f"{k}: {pairs[k][2]}" for k in (*before, *after) if pairs[k][2]],
    }


def deviation(sequence: SyntheticSequence, k: int, state: OnlineState, sigma_rate: float) -> list[float]:
    """Largest errors (2,) in sigmas: of position, velocity and size of the rate; of attitude and rate."""
    truth = sequence.truth
    turns = [log_so3(state.R_NP.T @ (truth.R_NP[k] * turn)) for turn in HALF_TURNS]
    n = int(np.argmin([turn @ turn for turn in turns]))
    w_P, size = truth.w_P[k] * HALF_TURNS[n], np.linalg.norm(state.w_P) - np.linalg.norm(truth.w_P[k])
    of_centre = state.r_N - truth.r_N[k], state.v_N - truth.v_N[k]
    errors = np.concatenate([*of_centre, turns[n], state.w_P - w_P]) / np.sqrt(np.diagonal(state.covariance))
    largest = max(np.abs(errors[:6]).max(), abs(size) / sigma_rate), np.abs(errors[6:]).max()
    return [round(float(each), 2) for each in largest]


if __name__ == "__main__":
    command(main)
