"""The sheet of scenes: the right frames and parts of images, captions, and nothing rendered for naught."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import inverse_pose, transform_points
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.figures.contact_sheet import (
    TILE_PX,
    boxes_around,
    describe,
    frames_to_show,
    main,
    scene_files,
)

RIG = {"width_px": 96, "height_px": 72, "focal_px": 70.0}
SCENE = """
seed: 4
scene:
  frames: 8
  truth_horizon_s: 0
  rig: {width_px: 96, height_px: 72, focal_px: 70.0}
  motion: {position_m: [0.04, 0.0, 0.6], spin_rpm: [1.0, 9.0, 0.0]}
  light: {earth: 0.0}
  render: {samples: 1, bounces: 0}
"""


def _plan(**changes: object) -> SequencePlan:
    motion = {"position_m": [0.04, 0.0, 0.6]}
    values = {"frames": 8, "truth_horizon_s": 0, "rig": RIG, "motion": motion, **changes}
    return plan_sequence(Scene.model_validate(values), 4)


def test_one_command_draws_all_scenes(tmp_path: Path) -> None:
    for name in ("first", "second", "third"):
        (tmp_path / f"{name}.yaml").write_text(SCENE)
    sheet = tmp_path / "sheet.png"
    (tmp_path / "more").mkdir()
    (tmp_path / "third.yaml").rename(tmp_path / "more" / "third.yaml")
    sources = [tmp_path / "first.yaml", tmp_path / "second.yaml", tmp_path / "more"]
    assert main([*map(str, sources), "-o", str(sheet), "--workers", "1"]) == 0
    image = np.asarray(Image.open(sheet))
    assert image.shape[1] == 1600
    # Two strips above one: the last place stays empty.
    assert image[-120:, 850:].std() == 0
    for place in (image[60:180, 30:200], image[60:180, 850:1000], image[-120:, 30:200]):
        assert np.mean(place > 40) > 0.1


def test_frames_show_what_arrives_the_eclipse_and_the_target_leaving() -> None:
    assert frames_to_show(_plan()) == [1, 3, 5, 7]
    assert frames_to_show(_plan(sensor={"dropped_frames": [0, 1, 2, 3]})) == [4, 5, 6, 7]
    light = {"eclipse": {"start_s": 10.0, "duration_s": 8.0, "ramp_s": 4.0}}
    plan = _plan(frames=60, light=light)
    assert [plan.time_s(k) for k in frames_to_show(plan)] == [5.0, 8.0, 14.0, 20.0]
    poses = [{"t_s": 4.0}, {"t_s": 6.0, "attitude_deg": [0, 90, 0]}, {"t_s": 9.0, "attitude_deg": [0, 90, 0]}]
    inspector = {"profile": "waypoints", "waypoints": [*poses, {"t_s": 11.0}]}
    before, leaving, gone, after = frames_to_show(_plan(frames=30, inspector=inspector))
    assert before < 8 < leaving < 12 < gone < 18
    assert after > 22


def test_the_parts_shown_hold_the_whole_target_at_one_scale() -> None:
    plan = _plan(motion={"position_m": [0.1, 0.05, 1.5], "velocity_mm_s": [-40, 0, 0]})
    frames = [0, 3, 7]
    boxes = boxes_around(plan, frames)
    assert len({round(right - left, 6) for left, _, right, _ in boxes}) == 1
    for k, (left, top, right, bottom) in zip(frames, boxes, strict=True):
        assert (right - left) / (bottom - top) == pytest.approx(TILE_PX[0] / TILE_PX[1])
        X_CG = inverse_pose(plan.X_NC[k]) @ plan.target.X_NG[k]
        uv = plan.cameras[0].project(transform_points(X_CG, plan.body.mesh.vertices))
        assert (uv > (left, top)).all() and (uv < (right, bottom)).all()
        assert right - left < 0.6 * 96
    away = _plan(motion={"position_m": [0.0, 0.0, 0.8], "velocity_mm_s": [500, 0, 0]})
    assert boxes_around(away, [0, 7]) == [(0.0, 0.0, 96.0, 72.0)] * 2


def test_the_words_tell_target_spin_and_what_is_special() -> None:
    plain = Scene.model_validate({"motion": {"spin_rpm": [3.0, 4.0, 0.0]}})
    assert describe(plain) == ("free flyer 0.22 m", "5 rpm")
    special = Scene.model_validate(
        {
            "body": {"family": "mesh", "path": "a/probe.stl", "metres_per_unit": 1},
            "inspector": {"profile": "circle"},
            "light": {"eclipse": {"duration_s": 10}},
            "sensor": {"bits": 12},
        }
    )
    assert describe(special) == ("probe", "no spin", "circling camera", "10 s of eclipse", "12 bits")


def test_a_source_without_scenes_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="has no configuration"):
        scene_files([tmp_path])
    assert main([str(tmp_path), "-o", str(tmp_path / "sheet.png")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
