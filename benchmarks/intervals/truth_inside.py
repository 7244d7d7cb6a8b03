"""Whether the truth lies in every interval, and how wide each is against that of the true body's hull.

Motions without images first: boxes with landmarks on their surface, random inertias and centres of mass. The
hull of the landmarks stands for the surface, extended where it closes what was not seen; where only one side
was seen, it has no volume, and there are no intervals. Then, with ``--runs``, folders of finished runs, each
beside its sequence: the hull is that of the run's mesh. The true body's hull goes through the same
computation.

    python -m benchmarks.intervals.truth_inside [--seeds 5] [--runs RUN=SEQUENCE ...]
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.presentation import print_table
from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.problem.inertia import FORMS, inertia_by_parameters
from polhode.config.backend_settings import Backend
from polhode.config.loader import load_config
from polhode.errors import RunFailure
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.mapping.mesh_files import read_ply
from polhode.pipeline.evaluation import truth_of_frames
from polhode.pipeline.intervals.body_hull import BodyHull, body_hull, hull_around
from polhode.pipeline.intervals.find_intervals import intervals_in
from polhode.pipeline.intervals.motion_limits import motion_limits
from polhode.pipeline.run_directory.archives import read_covariance
from polhode.pipeline.run_directory.point_cloud_file import read_landmarks
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.summary_schema import Intervals
from polhode.pipeline.run_directory.trajectory_file import read_trajectory
from polhode.progress import Silent
from polhode.records import Identifiability
from polhode.simulation.monte_carlo import RPM, SyntheticScene, generate

COLUMNS = "motion | quantities | truth inside | width over that of the true hull: median | largest"
MOTIONS: dict[str, tuple[tuple[float, float, float], int]] = {
    "pure spin": ((0.0, 0.0, 8.0), 40),
    "flat spin": ((8.0, 0.0, 0.0), 40),
    "symmetric body, spin about its axis": ((0.0, 0.0, 6.0), 40),
    "symmetric body, nutating": ((3.0, 1.0, 5.0), 40),
    "at rest": ((0.0, 0.0, 0.0), 20),
    "two turns, slow": ((0.7, 2.0, 1.0), 65),
}
"""Rates [RPM] along the principal axes, largest moment first, and frames at 0.5 s."""
SIZE_M = 0.11


@dataclass(frozen=True)
class Case:
    """What the intervals of one estimate are made from, and the truth in its frames."""

    found: BodyHull
    true: BodyHull
    com_G: Array
    R_GP: Array
    J_G: Array
    covariance: Array
    w_G: Array
    known: Identifiability
    settings: Backend
    true_com_G: Array
    true_k: tuple[float, float]

    def intervals(self, hull: BodyHull) -> Intervals | None:
        """By a hull."""
        J, by_parameters = inertia_by_parameters(self.J_G, FORMS[self.settings.inertia])
        limits = motion_limits(
            *(self.com_G, self.R_GP, J, by_parameters, self.covariance, self.w_G, 2.0 * hull.radius_m)
        )
        return intervals_in(hull, limits, self.known, self.settings.bounds)[0]

    def rows(self) -> Iterator[tuple[str, bool, float]]:
        """Name of each interval, whether the truth is inside, its width over that by the true hull."""
        found, true = self.intervals(self.found), self.intervals(self.true)
        if found is None or true is None:
            return
        shift = self.R_GP.T @ (self.true_com_G - self.com_G)
        pairs = [("k1", found.k1, true.k1, self.true_k[0]), ("k2", found.k2, true.k2, self.true_k[1])]
        for n, axis in enumerate("xyz"):
            if found.com_shift_P is not None and true.com_shift_P is not None:
                pairs.append((f"com_{axis}", found.com_shift_P[n], true.com_shift_P[n], shift[n]))
        for name, own, best, truth in pairs:
            if own is not None and best is not None:
                inside = own[0] <= truth <= own[1]
                yield name, bool(inside), (own[1] - own[0]) / max(best[1] - best[0], 1e-12)
        if found.com_G is not None:
            low, high = np.array(found.com_G)
            inside = bool(np.all(low <= self.true_com_G) and np.all(self.true_com_G <= high))
            yield "com_G", inside, float("nan")


def generated(motion: str, seed: int) -> Case | None:
    """A random body in one of the motions; None: no motion was found."""
    rng = np.random.default_rng([seed, 22])
    spin, frames = MOTIONS[motion]
    squares = np.sort(rng.uniform(0.3, 1.0, 3))
    if motion.startswith("symmetric"):
        squares[0] = squares[1]
    moments = squares.sum() - squares
    R_GP = exp_so3(rng.normal(size=3))
    com_G = rng.uniform(-0.15, 0.15, 3) * SIZE_M
    scene = SyntheticScene(
        frames=frames, landmarks=400, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.1, shape="box",
        radius_m=SIZE_M, J_G=R_GP @ np.diag(moments) @ R_GP.T, com_G=tuple(com_G.tolist()),
        w_G=tuple((R_GP @ np.array(spin) * RPM).tolist()), accel_psd=1e-8, torque_psd=1e-8,
    )  # fmt: skip
    sequence = generate(scene, seed)
    config = Backend(process_noise="given", accel_psd=1e-8, torque_psd=1e-8)
    try:
        initial = initialize_motion(sequence.tracks, sequence.relative, config)
        estimate = estimate_motion(sequence.tracks, initial, config, Silent())
    except RunFailure:
        return None
    X_foundtrue = inverse_pose(estimate.X_NG[0]) @ sequence.X_NG[0]
    marks = estimate.landmarks
    corners = trimesh.creation.box(2.0 * SIZE_M * np.array([1.0, 0.7, 0.5])).vertices
    true = hull_around(transform_points(X_foundtrue, corners))
    found = seen_hull(marks.p_G[marks.observations >= 3], true)
    if found is None or true is None or estimate.covariance_last_body is None:
        return None
    return Case(
        *(found, true, estimate.mass.com_G, estimate.mass.R_GP, estimate.mass.J_G),
        *(estimate.covariance_last_body, estimate.mass.R_GP @ estimate.w_P[-1], estimate.mass.identifiable),
        *(config, transform_points(X_foundtrue, com_G[None])[0], (sequence.truth.k1, sequence.truth.k2)),
    )


def seen_hull(points: Array, true: BodyHull | None) -> BodyHull | None:
    """The hull of points (n, 3) on the true surface, extended where it closes what was not seen."""
    seen = hull_around(points)
    if seen is None or true is None:
        return None
    mesh = trimesh.convex.convex_hull(seen.vertices)
    inside = true.offsets - mesh.triangles_center @ true.normals.T
    side = true.normals[np.argmin(inside, axis=1)]
    faces_out = np.einsum("nk,nk->n", mesh.face_normals, side) > 0.5
    closing = (inside.min(axis=1) > 0.1 * SIZE_M) | ~faces_out
    if not closing.any():
        return seen
    share = float(mesh.area_faces[closing].sum() / mesh.area)
    outwards = mesh.area_faces[closing] @ mesh.face_normals[closing]
    return hull_around(points, 0.0, share, outwards / np.linalg.norm(outwards))


def of_run(run: Path, sequence: Path) -> Case | None:
    """A finished run; None: it has no estimate or no hull."""
    summary, table = read_summary(run), read_trajectory(run)
    truth = truth_of_frames(sequence, table.timestamps_ns)
    covariance = read_covariance(run).last_body
    parts, known = summary.identifiable_components, summary.identifiable
    if summary.inertia is None or truth is None or covariance is None or parts is None or known is None:
        return None
    com_G, R_GP = np.array(summary.com_G), np.array(summary.R_GP)
    R_NG, R_true = table.R_NP[0] @ R_GP.T, truth.R_NP[0] @ truth.R_GP.T
    X_NG = make_pose(R_NG, table.r_N[0] - R_NG @ com_G)
    X_foundtrue = inverse_pose(X_NG) @ make_pose(R_true, truth.r_N[0] - R_true @ truth.com_G)
    mesh = trimesh.load(sequence / "mav0" / "target0" / "mesh.ply", process=False)
    found = body_hull(read_ply(run / "mesh.ply"), read_landmarks(run / "landmarks.ply"), summary.coverage)
    true = hull_around(transform_points(X_foundtrue, np.asarray(mesh.vertices)))
    if found is None or true is None:
        return None
    identifiable = Identifiability(
        known.k1,
        known.k2,
        known.com,
        known.axes,
        {},
        np.array(parts.com_P),
        np.array(parts.axes_P),
        np.zeros(8),
    )
    return Case(
        *(found, true, com_G, R_GP, np.array(summary.inertia.J_G), covariance, R_GP @ table.w_P[-1]),
        *(identifiable, load_config(run / "config.yaml").backend),
        *(transform_points(X_foundtrue, truth.com_G[None])[0], (truth.k1, truth.k2)),
    )


def row(name: str, cases: list[Case]) -> list[str]:
    """A line of the table."""
    rows = [each for case in cases for each in case.rows()]
    inside = sum(inside for _, inside, _ in rows)
    widths = np.array([width for _, _, width in rows if np.isfinite(width)])
    names = ", ".join(sorted({name for name, _, _ in rows})) or "none: all is determined"
    shown = [f"{np.median(widths):.3f}", f"{widths.max():.3f}"] if len(widths) else ["", ""]
    return [name, names, f"{inside} of {len(rows)}", *shown]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--short", action="store_true", help="one seed")
    parser.add_argument("--runs", nargs="*", default=[], metavar="RUN=SEQUENCE")
    options = parser.parse_args()
    seeds = 1 if options.short else options.seeds

    def lines() -> Iterator[list[str]]:
        for motion in MOTIONS:
            cases = [generated(motion, seed) for seed in range(seeds)]
            found = [case for case in cases if case is not None]
            yield row(f"{motion} ({len(found)} of {seeds} solved)", found)
        for pair in options.runs:
            run, _, sequence = pair.partition("=")
            case = of_run(Path(run), Path(sequence))
            yield row(run, [] if case is None else [case])

    print_table(COLUMNS, lines(), right_from=2)


if __name__ == "__main__":
    main()
