"""The model's pictures look like the images where motion and surface are right, and only there."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.mapping.visibility import MeshViewer
from polhode.pipeline.checks.answer_checks.image_motion import model_check
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.report.pictures.model_comparison import compare_frames
from polhode.report.shape_figures import vertex_rgb
from polhode.simulation.monte_carlo import RIG

FRAMES = 6
SUN_N = np.array([0.6, -0.3, -0.74]) / np.linalg.norm([0.6, -0.3, -0.74])


def poses(turn_deg: float) -> Array:
    """(F, 4, 4) of a ball 0.9 m away that turns by so much from frame to frame."""
    angles = np.deg2rad(turn_deg) * np.arange(FRAMES)
    return make_pose(exp_so3(angles[:, None] * [0.0, 1.0, 0.0]), np.tile([0.0, 0.0, 0.9], (FRAMES, 1)))


class Filmed:
    """Left images of a mesh that turns by 8 degrees a frame, in the Sun or as bright as its colours."""

    def __init__(self, mesh: trimesh.Trimesh, sun_N: Array | None = None) -> None:
        viewer, brightness = MeshViewer(mesh), vertex_rgb(mesh)[:, 0].astype(np.float64)
        self.images = []
        for X in poses(8.0):
            view = viewer.perspective(RIG, X, np.arange(RIG.width_px), np.arange(RIG.height_px))
            grey = view.values(brightness)
            if sun_N is not None:
                grey *= (view.values(np.asarray(mesh.vertex_normals)) @ (X[:3, :3].T @ sun_N)).clip(0.0, 1.0)
            self.images.append((np.round(0.8 * grey).astype(np.uint8), view.hit))

    def read_left(self, k: int) -> tuple[Any, Any]:
        return self.images[k]

    def shown(self, turn_deg: float = 8.0) -> tuple[StereoSequence, Rectifier, StereoTracks, MotionEstimate]:
        """The images with the motion that was found."""
        tracks = SimpleNamespace(
            X_NR=np.tile(np.eye(4), (FRAMES, 1, 1)), frame=np.arange(FRAMES), n_frames=FRAMES,
            time_s=np.arange(FRAMES, dtype=float),
        )  # fmt: skip
        rectifier = Rectifier(RIG, np.eye(4), None, ((RIG.width_px, RIG.height_px),) * 2)
        estimate = cast(MotionEstimate, SimpleNamespace(X_NG=poses(turn_deg)))
        return cast(StereoSequence, self), rectifier, cast(StereoTracks, tracks), estimate


def coloured(mesh: trimesh.Trimesh, grey: np.ndarray) -> trimesh.Trimesh:
    rgba = np.column_stack([grey, grey, grey, np.full_like(grey, 255)])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False)


@pytest.fixture(scope="module")
def body() -> trimesh.Trimesh:
    """A ball with marks of a few centimetres."""
    mesh, rng = trimesh.creation.icosphere(subdivisions=5, radius=0.2), np.random.default_rng(4)
    waves = rng.normal(scale=60.0, size=(40, 3))
    grey = np.cos(mesh.vertices @ waves.T + rng.uniform(0.0, 6.28, 40)).sum(axis=1)
    return coloured(mesh, (150.0 + 18.0 * grey).clip(40.0, 255.0).astype(np.uint8))


def test_the_right_motion_shows_the_images_and_wrong_motion_or_texture_does_not(
    body: trimesh.Trimesh,
) -> None:
    filmed, bare = Filmed(body), coloured(body, np.full(len(body.vertices), 200, dtype=np.uint8))
    right, wrong = (model_check(*filmed.shown(deg), body, None) for deg in (8.0, 0.0))
    assert right.value is not None and right.value < 0.1 and not right.reason
    assert wrong.value is not None and wrong.value > 30.0
    assert "does not look like the images" in wrong.reason
    # texture that only the images have is a doubt, that of neither is none
    assert model_check(*filmed.shown(), bare, None).reason
    for seen, mesh in ((Filmed(bare), bare), (filmed, trimesh.Trimesh())):
        check = model_check(*seen.shown(), mesh, None)
        assert check.value is None and not check.reason


def test_the_sun_shades_the_model(body: trimesh.Trimesh) -> None:
    shown = Filmed(body, SUN_N).shown()
    shaded, bright = (next(compare_frames(*shown, body, [2], sun_N=sun)).rms_grey for sun in (SUN_N, None))
    assert shaded < 2.0 and bright > 10.0
    check = model_check(*shown, body, SUN_N)
    assert check.value is not None and check.value < 0.1
