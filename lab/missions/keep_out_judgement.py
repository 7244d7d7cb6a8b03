"""One keep-out volume against the true body of a simulated sequence: what is inside, its size, clearances."""

from pathlib import Path
from time import process_time
from typing import Any

import cv2
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from lab.end_to_end.cost import seconds_of_one_sift
from lab.missions.smallest_sweep import FINE, Smallest, is_outer, outer_surface, smallest_sweep
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Array, Bools, inverse_pose, transform_points
from polhode.planning.keep_out import keep_out_truth
from polhode.planning.keep_out.keep_out_truth import Excess
from polhode.planning.keep_out.volumes import KeepOut, KeepOutOptions
from polhode.planning.plan import keep_out_of_run, surface_of
from polhode.planning.predict import final_estimates
from polhode.records.mesh_metrics import distance_to_surface, encloses
from polhode.records.read_truth import read_truth
from polhode.report.evaluation import TrueBody, true_body_ahead
from polhode.runtime.errors import InputError

CELLS = 1.0
"""Edge of the cells in which the smallest volume is counted, over that of the volume's grid"""
CLAIMS = 60
"""Places and instants at which a claimed distance is compared with the true one"""
GROWN = 0.5
"""By this share of its diagonal the box of the volume is grown for them"""
LEAST_WRONG_M = 1e-6
"""A claim that is farther above the truth than this is wrong: beyond the rounding of both"""


def keep_out_judgement(run: Path, sequence: Path, options: KeepOutOptions, seed: int) -> dict[str, Any]:
    """A row of the record; a run without a volume says why under "none". seed: of the claims."""
    start_s = process_time()
    try:
        found = keep_out_of_run(run, options)
    except InputError as error:
        return {"none": str(error)}
    seconds = process_time() - start_s
    mesh, motion = read_truth(sequence).mesh, found.instant.motion
    assert mesh is not None
    body = true_body_ahead(run, sequence, motion.time_s, keep_out_truth.POINTS)
    smallest = _smallest(found, run, mesh, body, options)
    return {
        "seconds_cpu": round(seconds, 2),
        "sift_cpu": round(seconds_of_one_sift(sequence, cv2.SIFT_create(), target_mask), 2),
        "covers": found.body.covers,
        "confidence": options.confidence,
        "hypotheses": len(found.instant.hypotheses),
        "factor": found.swept.factor,
        "added_m": found.swept.added_m,
        **_containment(found, run, sequence, mesh, body),
        **_surface(found.swept.mesh),
        "volume_m3": found.swept.volume_m3,
        "smallest_m3": smallest.volume_m3,
        "ratio": found.swept.volume_m3 / smallest.volume_m3,
        "ratio_to_union": found.swept.volume_m3 / smallest.union_m3,
        "leaving_union": smallest.leaving,
        "claims": _claims(found, mesh, body, seed),
        "judging_cpu": round(process_time() - start_s - seconds, 2),
    }


def _containment(
    found: KeepOut, run: Path, sequence: Path, mesh: trimesh.Trimesh, body: TrueBody
) -> dict[str, Any]:
    """Under "swept" and "instant", for the points that some frame saw in light and for the others: their
    number, the share that is inside, how far the farthest comes out, also over the body's longest side; what
    the run's mesh lacks of the latter.
    """
    size_m = float(mesh.extents.max())
    truth = keep_out_truth.keep_out_truth(found, surface_of(run), run, sequence)
    outer = is_outer(mesh, body.p_G)
    every = keep_out_truth.POINTS // keep_out_truth.FEW_POINTS
    return {
        "swept": _parts(truth.swept, outer, size_m),
        "instant": _parts(truth.instant, outer[::every], size_m),
        "least_from_mesh_m": truth.least_from_mesh_m,
    }


def _parts(excess: Excess, outer: Bools, size_m: float) -> dict[str, Any]:
    parts: dict[str, Any] = {}
    for name, points in (("seen", outer & excess.seen), ("unseen", outer & ~excess.seen)):
        farthest_m = excess.farthest_m(points)
        parts[name] = {
            "points": int(points.sum()),
            "share": excess.inside(points),
            "farthest_m": farthest_m,
            "farthest_share": None if farthest_m is None else farthest_m / size_m,
        }
    return parts


def _surface(mesh: trimesh.Trimesh) -> dict[str, Any]:
    """Whether the surface is closed."""
    return {"watertight": bool(mesh.is_watertight and mesh.is_winding_consistent)}


def _smallest(
    found: KeepOut, run: Path, mesh: trimesh.Trimesh, body: TrueBody, options: KeepOutOptions
) -> Smallest:
    step_m = CELLS * found.swept.level.step_m
    outer = outer_surface(mesh, FINE * step_m)
    # where the run's G has them at the last pair
    in_run = transform_points(inverse_pose(body.last_estimate_X_NG) @ body.last_X_NG, outer)
    return smallest_sweep(in_run, final_estimates(run), options.horizon_s, options.confidence, step_m)


def _claims(found: KeepOut, mesh: trimesh.Trimesh, body: TrueBody, seed: int) -> dict[str, Any]:
    """Clearances at random places and instants: how many are more than there is, by whether a frame saw the
    nearest part in light, and by how much at most.
    """
    rng = np.random.default_rng([seed, 0xC1A])
    low, high = found.swept.mesh.bounds
    more = GROWN * np.linalg.norm(high - low)
    places = rng.uniform(low - more, high + more, (CLAIMS, 3))
    instants = rng.integers(len(body.X_NG), size=CLAIMS)
    claimed = np.array([
        found.instant.signed_distance(int(k), p[None])[0] for k, p in zip(instants, places, strict=True)
    ])  # fmt: skip
    places_G = np.array([
        transform_points(inverse_pose(body.X_NG[k]), p[None])[0]
        for k, p in zip(instants, places, strict=True)
    ])  # fmt: skip
    true, of_seen = _true_distance(mesh, places_G), body.seen[cKDTree(body.p_G).query(places_G)[1]]
    # a place within the volume is promised no clearance
    over = np.where(claimed > 0.0, claimed - true, 0.0)
    return {
        "count": CLAIMS,
        "clear": int((claimed > 0.0).sum()),
        "wrong": int(((over > LEAST_WRONG_M) & of_seen).sum()),
        "wrong_of_unseen": int(((over > LEAST_WRONG_M) & ~of_seen).sum()),
        "most_over_m": float(max(over.max(), 0.0)),
    }


def _true_distance(mesh: trimesh.Trimesh, p_G: Array) -> Array:
    """Of points (n, 3) from a body (n,) [m], negative inside."""
    distance = distance_to_surface(mesh, p_G)
    low, high = mesh.bounds
    for n in np.flatnonzero(((p_G > low) & (p_G < high)).all(axis=1)):
        if encloses(mesh, p_G[n]):
            distance[n] *= -1.0
    return distance
