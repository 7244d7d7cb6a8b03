"""A simulated sequence, from the scene's description to the dataset on disk (CONTRACT.md)."""

import shutil
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from polhode.config.scene import Scene
from polhode.dataset_writer import (
    image_path,
    mask_path,
    write_camera_csv,
    write_inspector,
    write_png,
    write_sensor,
    write_truth,
)
from polhode.errors import InputError
from polhode.lie import Array, inverse_pose, transform_points
from polhode.progress import Progress
from polhode.records import Truth
from simulation.bodies import Body, build_body
from simulation.cameras import Camera, build_cameras, mount_pose
from simulation.motion import (
    MassDistribution,
    TargetMotion,
    camera_motion,
    mass_distribution,
    reported_inspector,
    target_motion,
)
from simulation.products import products_path, render_products, write_products
from simulation.render import Renderer
from simulation.sensor import expose


@dataclass(frozen=True)
class Plan:
    """All that is decided before the first ray: body, mass, cameras, and where everything is when."""

    scene: Scene
    seed: int
    body: Body
    mass: MassDistribution
    cameras: tuple[Camera, Camera]
    target: TargetMotion
    X_NC: Array
    """(F, 4, 4) left camera"""


def simulate(
    scene: Scene, seed: int, folder: Path, progress: Progress, workers: int = 1, overwrite: bool = False
) -> None:
    """Render a scene into the dataset ``folder``, with truth. The bytes do not depend on ``workers``.

    Raises InputError: the folder exists (unless ``overwrite``), or the scene cannot be rendered.
    """
    plan = plan_sequence(scene, seed)
    with _replacing(folder, overwrite) as draft:
        mav0 = draft / "mav0"
        write_calibration(plan, mav0)
        render_frames(plan, mav0, progress, workers)
        write_truth(mav0, truth_of(plan))


def plan_sequence(scene: Scene, seed: int) -> Plan:
    """Build the body and move it. Raises InputError for a scene that cannot be rendered."""
    body = build_body(scene.body, seed)
    mass = mass_distribution(scene.mass, body)
    plan = Plan(
        scene,
        seed,
        body,
        mass,
        build_cameras(scene.rig),
        target_motion(scene, mass, seed),
        camera_motion(scene),
    )
    _require_view(plan)
    return plan


def write_calibration(plan: Plan, mav0: Path) -> None:
    """Write the cameras' calibration and times, and the inspector's poses if it moves."""
    scene, X_BC = plan.scene, mount_pose(plan.scene.rig)
    frames_ns = plan.target.timestamps_ns[: scene.frames]
    for index, camera in enumerate(plan.cameras):
        path = mav0 / f"cam{index}"
        size = (camera.width_px, camera.height_px)
        write_sensor(path, camera.K, camera.dist, X_BC @ camera.X_CK, *size, rate_hz=1.0 / scene.interval_s)
        write_camera_csv(path, frames_ns)
    if scene.inspector.profile != "rest":
        X_NB = reported_inspector(scene, plan.X_NC, X_BC, np.random.default_rng([plan.seed, 0x1]))
        sigma_theta_rad = float(np.deg2rad(scene.inspector.sigma_theta_deg))
        write_inspector(mav0, frames_ns, X_NB, scene.inspector.sigma_p_m, sigma_theta_rad)


def render_frames(plan: Plan, mav0: Path, progress: Progress, workers: int) -> None:
    """Render all pairs, in this process or in several."""
    frames = range(plan.scene.frames)
    with progress.stage("rendering", len(frames)) as advance:
        if workers == 1:
            painter = _Painter(plan, mav0)
            for k in frames:
                painter.paint(k)
                advance()
            return
        # Spawned, not forked: embree's threads do not survive a fork.
        with ProcessPoolExecutor(workers, get_context("spawn"), _start_worker, (plan, mav0)) as pool:
            for _ in pool.map(_paint_in_worker, frames):
                advance()


def truth_of(plan: Plan) -> Truth:
    """The truth at the frames and over the horizon."""
    target, mass = plan.target, plan.mass
    return Truth(
        timestamps_ns=target.timestamps_ns,
        r_N=target.r_N,
        R_NP=target.R_NP,
        v_N=target.v_N,
        w_P=target.w_P,
        moments=mass.moments,
        k1=float(np.log(mass.moments[0] / mass.moments[1])),
        k2=float(np.log(mass.moments[1] / mass.moments[2])),
        com_G=mass.com_G,
        R_GP=mass.R_GP,
        mesh=plan.body.mesh,
    )


class _Painter:
    """Renders single pairs into the dataset."""

    def __init__(self, plan: Plan, mav0: Path) -> None:
        self._plan = plan
        self._mav0 = mav0
        self._renderer = Renderer(plan.body, plan.scene, plan.seed)

    def paint(self, k: int) -> None:
        """Render frame k: both images, and masks on request."""
        plan = self._plan
        stamp = int(plan.target.timestamps_ns[k])
        for index, camera in enumerate(plan.cameras):
            picture = self._renderer.picture(camera, plan.X_NC[k] @ camera.X_CK, plan.target.X_NG[k])
            noise = np.random.default_rng([plan.seed, 0x2, k, index])
            image = expose(picture.level, plan.scene.sensor, noise)
            write_png(image_path(self._mav0 / f"cam{index}", stamp), image)
            if asked := plan.scene.render.products:
                pose_NK, pose_NG = plan.X_NC[k] @ camera.X_CK, plan.target.X_NG[k]
                products = render_products(self._renderer, camera, pose_NK, pose_NG, asked)
                write_products(products_path(self._mav0, index, stamp), products)
            if plan.scene.render.masks:
                write_png(mask_path(self._mav0, index, stamp), picture.covered >= 0.5)


_painter: _Painter | None = None


def _start_worker(plan: Plan, mav0: Path) -> None:
    global _painter
    _painter = _Painter(plan, mav0)


def _paint_in_worker(k: int) -> None:
    assert _painter is not None  # the pool's initialiser has run
    _painter.paint(k)


def _require_view(plan: Plan) -> None:
    """Raise when a camera is inside the target or the target is never in view."""
    seen = False
    for k in range(plan.scene.frames):
        X_CG = inverse_pose(plan.X_NC[k]) @ plan.target.X_NG[k]
        for camera in plan.cameras:
            X_KG = inverse_pose(camera.X_CK) @ X_CG
            if np.linalg.norm(X_KG[:3, 3]) <= plan.body.radius_m:
                radius_m, t_s = plan.body.radius_m, k * plan.scene.interval_s
                raise InputError(
                    f"scene: the target (radius {radius_m:.3g} m) reaches the camera {t_s:g} s after "
                    "the start; move scene.motion.position_m away or check body.size_m and metres_per_unit"
                )
            seen = seen or _in_view(plan.body, camera, X_KG)
    if not seen:
        raise InputError(
            "scene: the target is never in view; scene.motion.position_m must be in front (z > 0)"
        )


def _in_view(body: Body, camera: Camera, X_KG: Array) -> bool:
    p_K = transform_points(X_KG, body.mesh.vertices)
    p_K = p_K[p_K[:, 2] > 1e-3]
    if len(p_K) == 0:
        return False
    uv = camera.project(p_K)
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] < camera.width_px) & (uv[:, 1] < camera.height_px)
    return bool(inside.any())


@contextmanager
def _replacing(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A draft beside ``folder`` that takes its place when all went well, and vanishes otherwise."""
    if folder.exists() and not overwrite:
        raise InputError(f"{folder} exists: choose another folder or pass --overwrite")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file, not a dataset: choose another folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise InputError(f"{folder} cannot be made ({error.strerror}): choose another folder") from error
    try:
        yield draft
        draft.chmod(0o755)
        _exchange(draft, folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _exchange(draft: Path, folder: Path) -> None:
    """Put the draft in the folder's place; what stood there is deleted last, so one of them always stands."""
    if not folder.exists():
        draft.rename(folder)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-old-", dir=folder.parent))
    folder.rename(aside / folder.name)
    draft.rename(folder)
    shutil.rmtree(aside)
