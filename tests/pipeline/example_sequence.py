"""A sequence whose truth is the estimate of the example, in another frame G."""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.geometry.rigid_body import propagate
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_sensor, write_truth
from polhode.records.truth import Truth
from tests.pipeline.conftest import Example

WIDTH, HEIGHT, FOCAL_PX = 160, 120, 120.0
X_TRUE_G_G = make_pose(exp_so3([0.4, 1.0, -0.7]), [0.05, -0.02, 0.03])
"""The truth's G is another frame than the estimate's."""


def write_sequence(example: Example, folder: Path) -> Path:
    """Silhouettes of the box, all lit, and its truth, 65 s past the last image."""
    motion, mass = example.estimate, example.estimate.mass
    K = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1]])
    mav0, caster = folder / "mav0", RayMeshIntersector(example.surface.mesh)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - K[0, 2]) / FOCAL_PX, (v - K[1, 2]) / FOCAL_PX, np.ones(u.shape)], -1).reshape(-1, 3)
    noise = np.random.default_rng(0).integers(0, 4, u.shape)
    for name, shift in (("cam0", 0.0), ("cam1", 0.09)):
        write_sensor(mav0 / name, K, np.zeros(4), make_pose(np.eye(3), [shift, 0, 0]), (WIDTH, HEIGHT), 2.0)
        write_camera_csv(mav0 / name, motion.timestamps_ns)
        for stamp, X_GN in zip(motion.timestamps_ns, inverse_pose(motion.X_NG), strict=True):
            eye, directions = X_GN[:3, :3] @ [shift, 0, 0] + X_GN[:3, 3], rays @ X_GN[:3, :3].T
            hit = caster.intersects_any(np.broadcast_to(eye, directions.shape), directions)
            picture = np.asarray(hit.reshape(u.shape) * 120 + noise, dtype=np.uint8)
            write_png(image_path(mav0 / name, int(stamp)), picture)
    ahead_s = np.arange(0.0, 66.0, 1.0)
    last = motion.r_N[-1], motion.v_N[-1], motion.R_NP[-1], motion.w_P[-1]
    later = propagate(ahead_s, *last, np.diag(mass.moments))
    seen = motion.r_N, motion.v_N, motion.R_NP, motion.w_P
    r_N, v_N, R_NP, w_P = (np.concatenate([a, b[1:]]) for a, b in zip(seen, later, strict=True))
    stamps = motion.timestamps_ns[-1] + (ahead_s * 1e9).astype(np.int64)
    box = example.surface.mesh.copy()
    box.apply_transform(X_TRUE_G_G)
    truth = Truth(
        timestamps_ns=np.concatenate([motion.timestamps_ns, stamps[1:]]),
        r_N=r_N,
        v_N=v_N,
        R_NP=R_NP,
        w_P=w_P,
        moments=mass.moments,
        k1=mass.k1,
        k2=mass.k2,
        com_G=X_TRUE_G_G[:3, :3] @ mass.com_G + X_TRUE_G_G[:3, 3],
        R_GP=X_TRUE_G_G[:3, :3] @ mass.R_GP,
        mesh=trimesh.Trimesh(box.vertices, box.faces, process=False),
    )
    write_truth(mav0, truth)
    return folder
