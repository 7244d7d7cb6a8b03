"""Our pose graph against GTSAM's on the same relative poses, of which many are wrong.

    python -m benchmarks.solvers.pose_graph [--seeds 5] [--short]

Sequences of 60 frames with 400 landmarks, 20 % gross outliers and a share of wrong relative poses. Ours joins
frames by groups of links that agree and then averages them robustly; GTSAM starts from a spanning tree of the
links with the most inliers and minimises all links together, by Levenberg-Marquardt with a Geman-McClure
kernel, or by graduated non-convexity with truncated least squares (Yang et al. 2020), which rejects outliers.
Printed: frames within 5 degrees of the truth, median attitude error of these, seconds; means over seeds.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import Annotated

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from tyro.conf import arg

from benchmarks.command import Short, command
from benchmarks.presentation import markdown_table
from polhode.backend.initialization.pose_graph import REJECT_RAD, REJECT_SHIFT, connect
from polhode.lie import Array, inverse_pose, log_so3
from polhode.records import RelativePoses
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SCENE = SyntheticScene(
    frames=60, landmarks=400, detection=0.4, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9]),
    sigma_uv_px=0.3, sigma_d_px=0.3, outliers=0.2,
)  # fmt: skip
WRONG_SHARES = (0.0, 0.2, 0.35, 0.5)
CLOSE_DEG = 5.0
MIN_INLIERS = 5


def main(
    seeds: Annotated[int, arg(help="Sequences per share of wrong links.")] = 5, short: Short = False
) -> None:
    """Measure and print the table."""
    rows = []
    for share in WRONG_SHARES[-2:-1] if short else WRONG_SHARES:
        results: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
        for seed in range(43, 44 if short else 43 + seeds):
            sequence = generate(replace(SCENE, wrong_pairs=share), seed)
            for name, method in METHODS.items():
                results[name].append(_measure(sequence, method))
        for name, found in results.items():
            close, error_deg, seconds = np.mean(found, axis=0)
            rows.append((f"{share:.0%}", name, f"{close:.1%}", f"{error_deg:.2f}", f"{seconds:.2f}"))
    head = ("wrong links", "pose graph", "frames within 5 deg", "median error of these [deg]", "seconds")
    print(markdown_table(head, rows, right_from=2))


def _measure(
    sequence: SyntheticSequence, method: Callable[[SyntheticSequence], Array]
) -> tuple[float, float, float]:
    """Share of frames close to the truth, their median attitude error [deg], seconds."""
    begin = perf_counter()
    X_RG = method(sequence)
    seconds = perf_counter() - begin
    X_NG = sequence.tracks.X_NR @ X_RG
    offset = np.swapaxes(sequence.X_NG[:, :3, :3], 1, 2) @ X_NG[:, :3, :3]
    # the frame G of a pose graph is free: that of the frame which most others agree with
    errors = np.rad2deg([np.linalg.norm(log_so3(reference.T @ offset), axis=1) for reference in offset])
    best = errors[np.argmax(np.sum(errors < CLOSE_DEG, axis=1))]
    close = best < CLOSE_DEG
    return float(np.mean(close)), float(np.median(best[close])), seconds


def _ours(sequence: SyntheticSequence) -> Array:
    tracks = sequence.tracks
    return connect(sequence.relative, tracks.time_s, tracks.X_NR[:, :3, :3])[0]


def _spanning_tree_poses(links: RelativePoses, n_frames: int) -> Array:
    """Poses X_RG (F, 4, 4) along the tree of the links with the most inliers."""
    weight = 1.0 / links.inliers
    tree = minimum_spanning_tree(coo_matrix((weight, (links.i, links.j)), shape=(n_frames, n_frames)))
    order, parent = breadth_first_order(tree, 0, directed=False)
    of_pair = dict(zip(zip(links.i, links.j, strict=True), links.X_RiRj, strict=True))
    X = np.tile(np.eye(4), (n_frames, 1, 1))
    for frame in order[1:]:
        pair = (parent[frame], frame)
        X_parent_frame = of_pair[pair] if pair in of_pair else inverse_pose(of_pair[pair[::-1]])
        X[frame] = inverse_pose(X_parent_frame) @ X[parent[frame]]
    return X


def _gtsam(sequence: SyntheticSequence) -> Array:
    """X_RG from GTSAM; its nodes are X_GR, so that X_RiRj is the difference of two nodes."""
    import gtsam

    relative, n_frames = sequence.relative, sequence.tracks.n_frames
    use = relative.inliers >= MIN_INLIERS
    links = RelativePoses(relative.i[use], relative.j[use], relative.X_RiRj[use], relative.inliers[use])
    distance_m = float(np.median(np.linalg.norm(links.X_RiRj[:, :3, 3], axis=1)))
    sigmas = np.array([REJECT_RAD] * 3 + [REJECT_SHIFT * distance_m] * 3) / 3.0
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i, j, X_ij in zip(links.i, links.j, links.X_RiRj, strict=True):
        graph.add(gtsam.BetweenFactorPose3(int(i), int(j), gtsam.Pose3(X_ij), noise))
    X_GR = inverse_pose(_spanning_tree_poses(links, n_frames))
    for frame, X in enumerate(X_GR):
        start.insert(frame, gtsam.Pose3(X))
    first = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(X_GR[0]), first))
    parameters = gtsam.GncLMParams()
    parameters.setKnownInliers([graph.size() - 1])
    result = gtsam.GncLMOptimizer(graph, start, parameters).optimize()
    return np.asarray(inverse_pose(np.array([result.atPose3(k).matrix() for k in range(n_frames)])))


METHODS = {"ours": _ours, "GTSAM, graduated non-convexity": _gtsam}


if __name__ == "__main__":
    command(main)
