"""The model's pictures look like the images where motion and surface are right, and only there."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from polhode.frontend.rectification import Rectifier
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.mapping.visibility import MeshViewer
from polhode.pipeline.checks.answer_checks.model_check import model_check
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.report.pictures.model_comparison import compare_frames
from polhode.report.shape_figures import vertex_rgb
from polhode.simulation.monte_carlo import RIG

FRAMES = 6
SUN_N = np.array([0.6, -0.3, -0.74]) / np.linalg.norm([0.6, -0.3, -0.74])


class Filmed:
    """Left images of a mesh at known poses, in the Sun or as bright as its colours."""

    def __init__(self, mesh: trimesh.Trimesh, rig: RectifiedRig, X_RG: Array, sun_N: Array | None) -> None:
        viewer, brightness = MeshViewer(mesh), vertex_rgb(mesh)[:, 0].astype(np.float64)
        self.images = []
        for X in X_RG:
            view = viewer.perspective(rig, X, np.arange(rig.width_px), np.arange(rig.height_px))
            grey = view.values(brightness)
            if sun_N is not None:
                grey *= (view.values(np.asarray(mesh.vertex_normals)) @ (X[:3, :3].T @ sun_N)).clip(0.0, 1.0)
            self.images.append((np.round(0.8 * grey).astype(np.uint8), view.hit))

    def read_left(self, k: int) -> tuple[Any, Any]:
        return self.images[k]


@pytest.fixture(scope="module")
def body() -> trimesh.Trimesh:
    """A ball with marks of a few centimetres."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.2)
    rng = np.random.default_rng(4)
    waves = rng.normal(scale=60.0, size=(40, 3))
    grey = np.cos(mesh.vertices @ waves.T + rng.uniform(0.0, 6.28, 40)).sum(axis=1)
    grey = (150.0 + 18.0 * grey).clip(40.0, 255.0).astype(np.uint8)[:, None]
    return coloured(mesh, np.hstack([grey, grey, grey, np.full_like(grey, 255)]))


def coloured(mesh: trimesh.Trimesh, rgba: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False)


def poses(turn_deg: float) -> Array:
    """(F, 4, 4) of a ball 0.9 m away that turns by so much from frame to frame."""
    angles = np.deg2rad(turn_deg) * np.arange(FRAMES)
    return make_pose(exp_so3(angles[:, None] * [0.0, 1.0, 0.0]), np.tile([0.0, 0.0, 0.9], (FRAMES, 1)))


def arguments(filmed: Filmed, X_RG: Array) -> tuple[StereoSequence, Rectifier, StereoTracks, MotionEstimate]:
    tracks = SimpleNamespace(
        X_NR=np.tile(np.eye(4), (FRAMES, 1, 1)), frame=np.arange(FRAMES), n_frames=FRAMES,
        time_s=np.arange(FRAMES, dtype=float),
    )  # fmt: skip
    size = (RIG.width_px, RIG.height_px)
    return (
        cast(StereoSequence, filmed),
        Rectifier(RIG, np.eye(4), None, (size, size)),
        cast(StereoTracks, tracks),
        cast(MotionEstimate, SimpleNamespace(X_NG=X_RG)),
    )


def displaced(body: trimesh.Trimesh, filmed: Filmed, X_RG: Array, sun_N: Array | None = None) -> Any:
    return model_check(*arguments(filmed, X_RG), body, sun_N)


def test_the_right_motion_shows_the_images_and_a_wrong_one_does_not(body: trimesh.Trimesh) -> None:
    filmed = Filmed(body, RIG, poses(8.0), None)
    right, wrong = displaced(body, filmed, poses(8.0)), displaced(body, filmed, poses(0.0))
    assert right.value < 0.1 and not right.reason
    assert wrong.value > 30.0 and "does not look like the images" in wrong.reason


def test_the_sun_shades_the_model(body: trimesh.Trimesh) -> None:
    filmed = Filmed(body, RIG, poses(8.0), SUN_N)
    given = (*arguments(filmed, poses(8.0)), body, [2])
    shaded, bright = (next(compare_frames(*given, sun_N=sun)).rms_grey for sun in (SUN_N, None))
    assert shaded < 2.0 and bright > 10.0
    assert displaced(body, filmed, poses(8.0), SUN_N).value < 0.1


def test_texture_that_only_the_images_have_is_a_doubt_and_that_of_neither_is_none(
    body: trimesh.Trimesh,
) -> None:
    bare = coloured(body, np.full((len(body.vertices), 4), 200, dtype=np.uint8))
    marked, plain = (Filmed(mesh, RIG, poses(8.0), None) for mesh in (body, bare))
    assert displaced(bare, marked, poses(8.0)).reason
    for filmed, mesh in ((plain, bare), (marked, trimesh.Trimesh())):
        check = displaced(mesh, filmed, poses(8.0))
        assert check.value is None and not check.reason
