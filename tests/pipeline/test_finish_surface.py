"""A surface is finished step by step; a step that fails costs only itself."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh.visual import ColorVisuals

from polhode.config import Config
from polhode.config.mapping_settings import Mapping
from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import make_pose
from polhode.mapping.finishing.detail_levels import DetailLevel
from polhode.mapping.mesh_files import write_ply
from polhode.pipeline import finish_surface as module
from polhode.pipeline.context import RunContext
from polhode.pipeline.finish_surface import finish_surface
from polhode.records.surface import SurfaceModel
from polhode.report import finish_run
from polhode.run_directory import outputs
from polhode.run_directory.summary import build_summary
from polhode.run_directory.summary_schema import ShapeFindings
from polhode.runtime.progress import Silent
from tests.mapping.rendered_views import RIG, rendered, tumbling

CONFIG = Config(outputs=("levels",), mapping=Mapping(hole_share=0.08))
BALL = trimesh.creation.icosphere(4, 0.08)
Finished = tuple[SurfaceModel, list[DetailLevel], ShapeFindings]


@pytest.fixture(scope="module")
def opened() -> SurfaceModel:
    near = np.linalg.norm(BALL.triangles_center - np.array([0.08, 0.0, 0.0]), axis=1) < 0.006
    mesh = trimesh.Trimesh(BALL.vertices, BALL.faces[~near], process=False)
    mesh.remove_unreferenced_vertices()
    n = len(mesh.vertices)
    mesh.visual = ColorVisuals(mesh, vertex_colors=np.full((n, 4), 80, dtype=np.uint8))
    return SurfaceModel(mesh, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


@pytest.fixture(scope="module")
def views() -> list[Any]:
    sun_R = np.array([0.4, -0.3, -0.86])
    return [rendered(BALL, X, sun_R, lambda p: 150 + 0 * p[:, 0]) for X in tumbling(12)]


@pytest.fixture
def finished(views: list[Any], example: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What finishes a surface, of a sequence and a rectifier of nothing but their frames."""
    monkeypatch.setattr(module, "_views", lambda *_: views)
    sequence: Any = SimpleNamespace(X_NC=np.tile(np.eye(4), (12, 1, 1)))
    rectifier: Any = SimpleNamespace(X_CR=np.eye(4), rig=RIG)
    motion: Any = SimpleNamespace(X_RG=np.stack(tumbling(12)), estimate=example.estimate)

    def finish(surface: SurfaceModel, config: Config = CONFIG) -> Finished:
        made = finish_surface(RunContext(sequence, rectifier, config, Silent()), surface, motion)
        return made.surface, made.levels, made.findings

    return finish


def test_all_is_found_and_written_the_same_each_time(
    opened: SurfaceModel, finished: Any, example: Any, tmp_path: Path
) -> None:
    surface, levels, found = finished(opened)
    assert found.mesh is not None and found.mesh.closed and found.mesh.holes_closed == 1
    assert found.mesh.colour == "albedo" and found.mesh.sun is not None
    assert found.coverage is not None and found.physics is not None
    assert surface.is_invented.sum() == found.mesh.invented_faces > 0
    again = finished(opened)
    write_ply(again[0], tmp_path / "again.ply")
    outputs.write_config(tmp_path, Config())
    outputs.write_estimate(tmp_path, example.tracks, example.estimate)
    outputs.write_surface(tmp_path, surface, levels)
    assert (tmp_path / "again.ply").read_bytes() == (tmp_path / "mesh.ply").read_bytes()
    assert again[2] == found
    names = [level.file for level in found.mesh.levels]
    assert names == ["mesh_lod1.glb", "mesh_lod2.glb"]
    assert {"mesh.ply", "mesh.glb", *names} <= {f.name for f in tmp_path.iterdir()}
    finish_run(tmp_path, build_summary(example.tracks, example.estimate, surface, {}, shape=found))
    page = (tmp_path / "report.html").read_text()
    assert "direction of the Sun in N" in page and names[0] in page
    assert found.physics.words[1].split("'")[0] in page


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("close_small_holes", "closing small holes"),
        ("divide_shading", "dividing the shading out"),
        ("coverage_of", "coverage"),
        ("levels_of", "lighter meshes"),
        ("check_physics", "mass against volume"),
        ("_views", "reading the images again"),
    ],
)
def test_a_step_that_fails_costs_only_itself(
    step: str, words: str, opened: SurfaceModel, finished: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> None:
        raise ValueError("of no use")

    monkeypatch.setattr(module, step, broken)
    surface, _, found = finished(opened)
    assert f"{words} failed and was left out: of no use" in found.warnings
    assert found.mesh is not None and len(surface.mesh.faces) >= len(opened.mesh.faces)


def test_each_step_can_be_switched_off_and_an_empty_surface_stays_empty(
    opened: SurfaceModel, finished: Any
) -> None:
    off = Config(mapping=Mapping(hole_share=0.0, divide_shading=False))
    surface, levels, found = finished(opened, off)
    assert found.mesh is not None and not found.mesh.closed and levels == []
    assert found.mesh.colour == "intensity" and found.mesh.sun is None
    np.testing.assert_array_equal(surface.mesh.faces, opened.mesh.faces)
    surface, levels, found = finished(
        SurfaceModel(trimesh.Trimesh(), np.zeros(0), np.zeros(0, dtype=np.int64))
    )
    assert len(surface.mesh.faces) == 0 and levels == [] and found.mesh is None and found.warnings == ()


def test_frames_are_cut_to_the_body() -> None:
    image = np.full((RIG.height_px, RIG.width_px), 200, dtype=np.uint8)
    target = np.zeros(image.shape, dtype=bool)
    target[50:70, 70:90] = True
    sequence: Any = SimpleNamespace(X_NC=np.tile(np.eye(4), (3, 1, 1)), read_left=lambda k: (image, target))
    size = (RIG.width_px, RIG.height_px)
    context = RunContext(sequence, Rectifier(RIG, np.eye(4), None, (size, size)), CONFIG, Silent())
    surface: Any = SimpleNamespace(mesh=trimesh.creation.box((0.16, 0.16, 0.16)))
    # the last one is not all in front of the camera
    X_RG = make_pose(np.tile(np.eye(3), (3, 1, 1)), [[0.0, 0.0, 0.5], [0.05, 0.0, 0.5], [0.0, 0.0, -0.1]])
    views = module._views(context, surface, X_RG)
    # 6 px around columns 79.5 +- 45.7 and rows 59.5 +- 45.7; the second one is cut by the border
    assert [(view.u0, view.v0, *view.image.shape) for view in views] == [(27, 7, 105, 105), (56, 7, 105, 104)]
    assert all(view.silhouette.sum() == 400 and view.image.shape == view.silhouette.shape for view in views)
    # and to what of the target the surface lacks, as a boom
    target[5, 150] = True
    first = module._views(context, surface, X_RG)[0]
    assert (first.u0, first.v0, *first.image.shape) == (27, 0, 112, 130) and first.silhouette.sum() == 401
