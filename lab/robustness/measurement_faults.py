"""Faults in the measurements themselves, of random bodies: what the checks and the verdict make of them.

    python -m lab.robustness.measurement_faults [--scenes 26] [--workers 1] [--short] [--table]

No images: a random body tumbles, a stereo camera measures its landmarks (0.3 px, 0.1 px of disparity, 3 % of
gross errors), and one thing is wrong, by an amount drawn at random from slight to gross (``FAULTS``). The
back end solves, from the true poses; the checks that need no images judge. Three hundred runs take an hour,
so that limits can be judged by the distributions of their values.

A run is a row of the record, as those of ``lab/robustness/data_faults.py``, whose "wrong" it shares.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Annotated, Any
from zlib import crc32

import numpy as np
import trimesh
from tyro.conf import arg

from lab.command import RECORDS, Record, Short, Workers, command
from lab.presentation import print_table
from lab.record import Case, complete, measured
from lab.robustness.judge import judged
from polhode.backend import estimate_motion
from polhode.config import Config
from polhode.frontend.features.stereo import StereoFeatures
from polhode.geometry.camera import stereo_jacobian
from polhode.geometry.lie import Array, Bools, Ints, exp_so3, inverse_pose
from polhode.pipeline.checks.answer_checks.check_answer import check_answer
from polhode.pipeline.checks.data_checks.check_data import check_data
from polhode.pipeline.runner import Stopwatch
from polhode.records.estimate import InitialMotion
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.records.truth import Truth
from polhode.run_directory.outputs import write_estimate
from polhode.run_directory.summary import build_summary, write_summary
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticSequence, generate, random_scene

RECORD = RECORDS / "measurement_faults"
SCENE: dict[str, Any] = {
    "frames": 40,
    "landmarks": 500,
    "detection": 0.35,
    "sigma_uv_px": 0.3,
    "sigma_d_px": 0.1,
    "outliers": 0.03,
    "accel_psd": 1e-8,
    "torque_psd": 1e-8,
}
NO_FEATURES = StereoFeatures(
    np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 4), dtype=np.float32)
)
NO_LINKS = RelativePoses(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros(0, np.int64)
)


@dataclass(frozen=True)
class Seen:
    """A sequence with what the faults need: each observation's point, and how it moves in the image."""

    sequence: SyntheticSequence
    sun_N: Array
    """(3,) unit vector towards the Sun"""
    rng: np.random.Generator

    @property
    def tracks(self) -> StereoTracks:
        """The measurements."""
        return self.sequence.tracks

    @property
    def R_RG(self) -> Array:
        """(M, 3, 3)"""
        X = inverse_pose(self.sequence.X_NR) @ self.sequence.X_NG
        return np.asarray(X[self.tracks.frame, :3, :3])

    @property
    def p_G(self) -> Array:
        """(M, 3) [m]"""
        return self.sequence.p_G[self.tracks.landmark]

    def p_R(self, p_G: Array) -> Array:
        """(M, 3) points in G as seen in the frames of the observations [m]."""
        X = (inverse_pose(self.sequence.X_NR) @ self.sequence.X_NG)[self.tracks.frame]
        return np.asarray(np.einsum("nij,nj->ni", X[:, :3, :3], p_G) + X[:, :3, 3])

    def moved(self, p_G: Array) -> StereoTracks:
        """The measurements, had the points been elsewhere."""
        rig = self.tracks.rig
        shift = rig.project(self.p_R(p_G)) - rig.project(self.p_R(self.p_G))
        return self.shifted(shift)

    def shifted(self, shift_px: Array) -> StereoTracks:
        """The measurements plus (M, 3) of u, v and disparity."""
        return replace(self.tracks, uvd_px=self.tracks.uvd_px + shift_px)

    def disparity(self, shift_px: Array) -> StereoTracks:
        """The measurements plus (M,) of the disparity alone."""
        return self.shifted(np.outer(shift_px, [0.0, 0.0, 1.0]))

    @property
    def outwards(self) -> Array:
        """(M, 3) unit vectors in G, from the centre of mass."""
        out = self.p_G - self.sequence.truth.com_G
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))

    def chosen(self, share: float) -> Bools:
        """Observations (M,) of a share of the landmarks."""
        return np.asarray((self.rng.random(self.tracks.n_landmarks) < share)[self.tracks.landmark])


def _few(seen: Seen, share: float) -> StereoTracks:
    rows = seen.chosen(share)
    landmark = np.unique(seen.tracks.landmark[rows], return_inverse=True)[1].astype(np.int64)
    kept = {name: getattr(seen.tracks, name)[rows] for name in ("frame", "uvd_px", "sigma_px")}
    return replace(seen.tracks, landmark=landmark, **kept)


def _focal(seen: Seen, share: float) -> StereoTracks:
    return replace(
        seen.tracks, rig=replace(seen.tracks.rig, focal_px=seen.tracks.rig.focal_px * (1.0 + share))
    )


def _step(seen: Seen, px: float) -> StereoTracks:
    return seen.disparity(np.asarray(px * (seen.tracks.frame > seen.tracks.n_frames // 2), dtype=np.float64))


def _late(seen: Seen, delay_s: float) -> StereoTracks:
    truth, rig, k = seen.sequence.truth, seen.tracks.rig, seen.tracks.frame
    w_N = np.einsum("fij,fj->fi", truth.R_NP, truth.w_P)[k]
    arm_N = np.einsum("nij,nj->ni", truth.R_NP[k] @ truth.R_GP.T, seen.p_G - truth.com_G)
    v_N = truth.v_N[k] + np.cross(w_N, arm_N)
    v_R = np.einsum("nji,nj->ni", seen.sequence.X_NR[k, :3, :3], v_N)
    speed = np.einsum("nij,nj->ni", stereo_jacobian(seen.p_R(seen.p_G), rig.focal_px, rig.baseline_m), v_R)
    return seen.disparity(-delay_s * (speed[:, 0] - speed[:, 2]))


def _distortion(seen: Seen, px: float) -> StereoTracks:
    rig = seen.tracks.rig
    off = seen.tracks.uvd_px[:, :2] - [rig.cx_px, rig.cy_px]
    bent = px * off * np.sum(off**2, axis=1, keepdims=True) / (0.5 * rig.width_px) ** 3
    return seen.shifted(np.column_stack([bent, np.zeros(len(bent))]))


def _oblique(seen: Seen, px: float) -> StereoTracks:
    towards_R = -seen.p_R(seen.p_G)
    towards_R /= np.linalg.norm(towards_R, axis=1, keepdims=True)
    facing = np.einsum("ni,nij,nj->n", towards_R, seen.R_RG, seen.outwards)
    return seen.disparity(px * (np.minimum(1.0 / np.maximum(facing, 0.2), 5.0) - 1.0))


def _slide(seen: Seen, share: float) -> StereoTracks:
    sun_G = (seen.sun_N @ seen.sequence.X_NG[:, :3, :3])[seen.tracks.frame]
    n = seen.outwards
    along = sun_G - np.sum(sun_G * n, axis=1, keepdims=True) * n
    size_m = share * float(np.median(np.linalg.norm(seen.p_G - seen.sequence.truth.com_G, axis=1)))
    return seen.moved(seen.p_G + size_m * along)


def _second_motion(seen: Seen, slower: float) -> StereoTracks:
    """Half of the landmarks turn slower by a share of the rate, as if they hung back on the surface."""
    truth, time_s = seen.sequence.truth, seen.tracks.time_s[seen.tracks.frame]
    axis_G = truth.R_GP @ truth.w_P.mean(axis=0)
    first = np.full(seen.tracks.n_landmarks, np.inf)
    np.minimum.at(first, seen.tracks.landmark, time_s)
    turn = -slower * (time_s - first[seen.tracks.landmark]) * seen.chosen(0.5)
    turned = np.einsum("nij,nj->ni", exp_so3(np.outer(turn, axis_G)), seen.p_G - truth.com_G)
    return seen.moved(turned + truth.com_G)


def _swapped(seen: Seen, share: float) -> StereoTracks:
    """Tracks that go on, from their middle, on a neighbouring point."""
    n, tracks = seen.tracks.n_landmarks, seen.tracks
    middle = np.bincount(tracks.landmark, tracks.frame, n) / np.maximum(
        np.bincount(tracks.landmark, minlength=n), 1
    )
    late = seen.chosen(share) & (tracks.frame > middle[tracks.landmark])
    return seen.moved(seen.p_G + late[:, None] * seen.rng.normal(0.0, 0.01, (n, 3))[tracks.landmark])


def _clock(seen: Seen, jump_s: float) -> StereoTracks:
    stamps = seen.tracks.timestamps_ns.copy()
    stamps[seen.tracks.n_frames // 2 :] += int(jump_s * 1e9)
    return replace(seen.tracks, timestamps_ns=stamps)


def _poses(seen: Seen, deg: float) -> StereoTracks:
    """The inspector's attitude swings, unreported."""
    k, X_NR = np.arange(seen.tracks.n_frames), seen.tracks.X_NR.copy()
    swing = np.deg2rad(deg) * np.stack([np.sin(k / 6.0), np.cos(k / 9.0), 0.0 * k], axis=1)
    X_NR[:, :3, :3] = exp_so3(swing) @ X_NR[:, :3, :3]
    return replace(seen.tracks, X_NR=X_NR)


Change = Callable[[Seen, float], StereoTracks]
FAULTS: dict[str, tuple[str, Change, float, float]] = {
    "none": ("undisturbed", lambda seen, _: seen.tracks, 1.0, 1.0),
    "few": ("few landmarks (share)", _few, 0.15, 0.6),
    "focal": ("focal length wrong (share)", _focal, 1e-3, 3e-2),
    "step": ("step of all disparities [px]", _step, 0.05, 2.0),
    "late": ("right camera late [s]", _late, 1e-3, 3e-2),
    "distortion": ("distortion at the side of the image [px]", _distortion, 0.3, 10.0),
    "oblique": ("disparities wrong at oblique surfaces [px]", _oblique, 0.02, 0.5),
    "slide": ("landmarks slide with the Sun (share of the radius)", _slide, 1e-3, 3e-2),
    "second_motion": ("half of the landmarks turn slower (share)", _second_motion, 1e-3, 1.0),
    "swapped": ("tracks go on elsewhere (share)", _swapped, 0.05, 0.6),
    "clock": ("clock jumps [s]", _clock, 0.02, 1.0),
    "poses": ("inspector's attitude swings, unreported [deg]", _poses, 0.03, 1.0),
}
"""Title, change, and the range from which its amount is drawn, uniform in the logarithm."""


def main(
    scenes: Annotated[int, arg(help="Random bodies and motions.")] = 26,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
    table: Annotated[bool, arg(help="Only print the table of what the record has.")] = False,
) -> None:
    """Measure what the record lacks, print the table."""
    names = ("focal",) if short else tuple(FAULTS)
    cases: list[Case] = [
        {"scene": scene, "fault": name} for scene in range(1 if short else scenes) for name in names
    ]
    print_faults(measured(record, cases) if table else complete(record, cases, measure, workers))


def measure(case: Case) -> Case:
    """The row of a case."""
    seed = crc32(f"{case['scene']} {case['fault']}".encode())
    rng, begin = np.random.default_rng(seed), time.perf_counter()
    scene = int(case["scene"])
    sequence = generate(random_scene(scene, shape=("sphere", "box")[scene % 2], **SCENE), scene)
    sun_N = np.random.default_rng([scene, 5]).normal(size=3) - [0.0, 0.0, 1.5]
    sun_N /= np.linalg.norm(sun_N)
    _, change, least, most = FAULTS[case["fault"]]
    amount = float(np.exp(rng.uniform(np.log(least), np.log(most))))
    tracks = change(Seen(sequence, sun_N, rng), amount)
    row: Case = {"amount": round(amount, 5)}
    try:
        row |= _solved(tracks, sequence)
    except RunFailure as failure:
        row |= {"status": "failed", "warnings": [str(failure)], "checks": {}, "claims": {}, "wrong": []}
    return row | {"seconds": round(time.perf_counter() - begin, 1)}


@dataclass(frozen=True)
class TrueSequence:
    """What the run is judged by."""

    stamps_ns: Ints
    truth: Truth
    later: Truth | None = None


def _solved(tracks: StereoTracks, sequence: SyntheticSequence) -> dict[str, Any]:
    """Status, checks and claims of the back end's estimate."""
    config, clock = Config(), Stopwatch()
    start = InitialMotion(
        inverse_pose(sequence.X_NR) @ sequence.X_NG, np.ones(tracks.n_frames, dtype=np.bool_)
    )
    estimate = estimate_motion(tracks, start, config.backend, Silent())
    context: Any = SimpleNamespace(
        sequence=SimpleNamespace(frozen=False, has_ranges=False),
        rectifier=SimpleNamespace(found=None),
        rig=tracks.rig,
        time_s=tracks.time_s,
        X_NR=tracks.X_NR,
        config=config,
    )
    with clock("checks"):
        findings = check_data(context, [NO_FEATURES] * tracks.n_frames, tracks, estimate)
        doubts = check_answer(tracks, estimate, NO_LINKS)
    box = SurfaceModel(trimesh.creation.box((0.1, 0.1, 0.1)), np.full(8, 1e-3), np.full(8, 3, dtype=np.int64))
    summary = build_summary(
        tracks, estimate, box, clock.seconds, findings.limits, checks=[*doubts, *findings.checks]
    )
    truth = replace(sequence.truth, timestamps_ns=tracks.timestamps_ns)
    with TemporaryDirectory() as name:
        write_estimate(Path(name), tracks, estimate)
        write_summary(summary, Path(name) / "summary.json")
        row = judged(Path(name), TrueSequence(tracks.timestamps_ns, truth))
    return {**row, "checks_seconds": round(clock.seconds["checks"], 2)}


def print_faults(lines: Sequence[Case]) -> None:
    """How many are wrong, and of these how many are not ok, by fault."""
    rows = []
    for name, (title, *_) in FAULTS.items():
        own = [line for line in lines if line["case"]["fault"] == name]
        wrong = [line for line in own if line["wrong"]]
        right = [line for line in own if not line["wrong"]]
        said, doubted = (sum(line["status"] != "ok" for line in some) for some in (wrong, right))
        if own:
            rows.append((title, len(own), len(wrong), said, len(right), doubted))
    print(f"\n{len(lines)} runs\n")
    print_table(("fault", "runs", "wrong", "said so", "right", "doubted"), rows, right_from=1)


if __name__ == "__main__":
    command(main)
