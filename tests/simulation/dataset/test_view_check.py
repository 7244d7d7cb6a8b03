"""Scenes that cannot be seen are refused, each with its line; all others are not."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from polhode.config.scene_settings import Scene
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import build_body
from polhode.simulation.dataset.plan import ViewCheck, plan_sequence


def _plan(**changes: object) -> None:
    rig = {"width_px": 96, "height_px": 72, "focal_px": 70.0}
    plan_sequence(Scene.model_validate({"frames": 3, "truth_horizon_s": 0, "rig": rig, **changes}), 4)


def _mesh(path: Path, mesh: trimesh.Trimesh) -> dict[str, object]:
    mesh.export(path)
    return {"family": "mesh", "path": str(path), "metres_per_unit": 1.0}


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ({"position_m": [0, 0, -0.6]}, "never in view, at none of 3 frames: it stays behind the cameras"),
        ({"position_m": [-0.5, 0, 0.6]}, "in view of one camera, but of both at none of 3 frames"),
        ({"position_m": [5, 0, 0.6]}, "never in view, at none of 3 frames: it stays beside the images"),
        (
            {"position_m": [0, 0, 0.02]},
            r"the left camera is inside the target at 0 s \(it is 0\.\d+ m",
        ),
        ({"position_m": [0.17, 0, 0.02]}, "the right camera is inside the target at 0 s"),
        (
            {"position_m": [0, 0, 0.6], "velocity_mm_s": [0, 0, -600]},
            "the left camera is inside the target at 1 s",
        ),
    ],
)
def test_a_target_that_cannot_be_seen_is_refused(motion: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        _plan(motion=motion)
    assert "\n" not in str(caught.value)
    assert "scene.motion.position_m" in str(caught.value)


def test_a_target_that_is_in_view_for_one_frame_is_enough() -> None:
    _plan(motion={"position_m": [-2.0, 0, 0.6], "velocity_mm_s": [2000, 0, 0]})
    _plan(motion={"position_m": [0, 0, 0.6], "velocity_mm_s": [5000, 0, 0]})


def test_a_long_body_may_pass_close_by_its_side(tmp_path: Path) -> None:
    """The sphere around it holds the cameras; the body does not."""
    body = _mesh(tmp_path / "boom.stl", trimesh.creation.box([4.0, 0.2, 0.2]))
    _plan(body=body, motion={"position_m": [0, 0, 0.5]})
    with pytest.raises(InputError, match=r"within 3 mm of the target .* nearer than 5 mm"):
        _plan(body=body, motion={"position_m": [0, 0, 0.103]})
    with pytest.raises(InputError, match=r"within 8 mm of the target .* nearer than 10 mm"):
        _plan(
            body=_mesh(tmp_path / "long.stl", trimesh.creation.box([10.0, 0.2, 0.2])),
            motion={"position_m": [0, 0, 0.108]},
        )


def test_a_wall_without_a_corner_is_in_view_and_a_shell_with_a_hole_encloses(tmp_path: Path) -> None:
    wall = _mesh(tmp_path / "wall.stl", trimesh.creation.box([9.0, 9.0, 0.1]))
    _plan(body=wall, motion={"position_m": [0, 0, 1.0]})
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    sphere.update_faces(np.arange(len(sphere.faces)) > 20)
    with pytest.raises(InputError, match="inside the target"):
        _plan(body=_mesh(tmp_path / "shell.stl", sphere), motion={"position_m": [0, 0, 0.3]})


def test_the_distance_to_the_surface_is_that_of_the_nearest_triangle(tmp_path: Path) -> None:
    cube = _mesh(tmp_path / "box.stl", trimesh.creation.box([1.0, 1.0, 1.0]))
    check = ViewCheck(build_body(Scene.model_validate({"body": cube}).body, 1))
    rng = np.random.default_rng(0)
    for p in rng.uniform(-1.5, 1.5, (50, 3)):
        outside = np.maximum(np.abs(p) - 0.5, 0)
        expected = np.linalg.norm(outside) if outside.any() else (0.5 - np.abs(p)).min()
        assert check.distance_m(p) == pytest.approx(expected, abs=1e-9)
