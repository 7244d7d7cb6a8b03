"""Images of one pose show the same surface in other light; the truth of pixels fits the images."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from polhode.config.train_settings import Corpus
from polhode.geometry.lie import inverse_pose, transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.train.surface.batches import KnownBody
from polhode.train.surface.known_bodies import NEXT_ALBEDO, prepare_bodies, share_of_shape, table
from polhode.train.surface.known_bodies import main as print_landmarks
from polhode.train.surface.landmarks import GATHER_PX, surface_at
from polhode.train.surface.lit_bodies import (
    CAST_SHADOW,
    FACING_AWAY,
    LIT,
    SKY,
    lit_body_path,
    on_target,
    read_lit_body,
    render_lit_body,
)
from tests.train.surface.conftest import CONFIG


def test_images_of_one_pose_differ_in_their_light_alone(bodies: dict[int, KnownBody]) -> None:
    body = bodies[0].body
    assert [body.pose_of(view) for view in range(4)] == [0, 1, 0, 1]
    assert [body.sun_of(view) for view in range(4)] == [0, 0, 1, 1]
    mask = on_target(body, 0)
    np.testing.assert_array_equal(body.light[0] == SKY, body.light[2] == SKY)
    np.testing.assert_array_equal(body.light[0] != SKY, mask)
    assert np.abs(body.grey[0].astype(float) - body.grey[2])[mask].mean() > 10.0


def test_kinds_of_light_are_those_of_the_images(bodies: dict[int, KnownBody]) -> None:
    grey, light = bodies[0].body.grey[0].astype(float), bodies[0].body.light[0]
    shadow = np.isin(light, (CAST_SHADOW, FACING_AWAY))
    assert shadow.sum() > 50
    assert (light == LIT).sum() > 500
    assert grey[light == LIT].mean() > 2.0 * grey[shadow].mean()
    assert grey[light == SKY].mean() < 5.0


def test_the_surface_of_one_pose_is_that_of_the_other(bodies: dict[int, KnownBody]) -> None:
    body = bodies[0].body
    v, u = np.nonzero(on_target(body, 0))
    p_K, normal = surface_at(body, 0, np.column_stack([u, v])[::31].astype(float))
    known = np.isfinite(p_K).all(axis=1)
    np.testing.assert_allclose(np.linalg.norm(normal[known], axis=1), 1.0, atol=1e-3)
    p_B = transform_points(body.X_KG[1] @ inverse_pose(body.X_KG[0]), p_K[known])
    uv = p_B[:, :2] / p_B[:, 2:] * float(body.focal_px) + body.centre_of_part_px(1)
    other, _ = surface_at(body, 1, uv)
    near = np.abs(other[:, 2] - p_B[:, 2]) < 2e-3
    # the rest is hidden in the other pose
    assert near.mean() > 0.6


def test_the_right_image_shows_the_target_at_the_disparity_of_its_middle(
    bodies: dict[int, KnownBody],
) -> None:
    body = bodies[0].body
    disparity = float(body.focal_px * body.baseline_m) / float(np.nanmedian(body.depth_m[0]))
    assert abs(disparity - body.shift_px[0]) <= 0.5
    left, right = body.grey[0].astype(float), body.right[0].astype(float)
    own = np.corrcoef(left.ravel(), right.ravel())[0, 1]
    beside = np.corrcoef(left[:, 8:].ravel(), right[:, :-8].ravel())[0, 1]
    assert own > beside + 0.05


def test_a_body_depends_on_its_number_alone(lit_body_corpus: Corpus, bodies: dict[int, KnownBody]) -> None:
    again = render_lit_body(lit_body_corpus.model_copy(update={"scenes": 2}), CONFIG, 1)
    np.testing.assert_array_equal(again.grey, bodies[1].body.grey)


def test_albedos_of_one_shape_have_its_poses_and_light_and_other_marks(
    two_albedos: dict[int, KnownBody], bodies: dict[int, KnownBody]
) -> None:
    assert sorted(two_albedos) == [0, NEXT_ALBEDO]
    first, second = (two_albedos[k].body for k in (0, NEXT_ALBEDO))
    np.testing.assert_array_equal(first.grey, bodies[0].body.grey)
    assert two_albedos[0].others == (second,)
    assert two_albedos[NEXT_ALBEDO].others == (first,)
    np.testing.assert_array_equal(first.X_KG, second.X_KG)
    np.testing.assert_allclose(first.depth_m, second.depth_m, atol=1e-5)
    for view in range(len(first.grey)):
        mask = on_target(first, first.pose_of(view))
        np.testing.assert_array_equal(first.light[view] == CAST_SHADOW, second.light[view] == CAST_SHADOW)
        assert np.abs(first.grey[view].astype(float) - second.grey[view])[mask].mean() > 5.0
    # what landmarks are is found for each albedo: few are at the same place
    places = [each.landmarks.p_G[~each.landmarks.is_weak] for each in two_albedos.values()]
    px_m = float(np.nanmedian(first.depth_m)) / float(first.focal_px)
    nearest, _ = cKDTree(places[1]).query(places[0])
    assert min(map(len, places)) > 30
    assert np.mean(nearest < 0.5 * px_m) < 0.25
    assert share_of_shape(two_albedos, [0, NEXT_ALBEDO]) == np.mean(nearest < GATHER_PX * px_m)
    rows = [line.split("|")[1:-1] for line in table(two_albedos, ("free_flyer",), 1).splitlines()]
    assert rows[0][-1].strip() == "under another albedo too [%]"
    assert [len(row) for row in rows] == [6] * 4


def test_what_is_there_is_not_rendered_again_and_damage_is_named(
    lit_body_corpus: Corpus, tmp_path: Path
) -> None:
    copy = tmp_path / "bodies"
    shutil.copytree(lit_body_corpus.folder, copy)
    corpus = lit_body_corpus.model_copy(update={"folder": str(copy)})
    path = lit_body_path(corpus, CONFIG, 2)
    before = path.stat().st_mtime_ns
    assert len(prepare_bodies(corpus, CONFIG, Silent(), 1)) == 3
    assert path.stat().st_mtime_ns == before
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="remove this file, and it is made again"):
        read_lit_body(path)


def test_the_command_prints_the_landmarks_of_families_and_of_bodies(
    lit_body_corpus: Corpus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "surface.yaml"
    surface = "{bodies: 3, suns: 2, poses: 2}"
    fields = lit_body_corpus.model_dump_json()
    config.write_text(f"train:\n  task: surface\n  corpus: {fields}\n  surface: {surface}\n")
    print_landmarks([str(config), "--workers", "1", "--chance", "1"])
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0].strip() for row in rows] == ["free_flyer", "asteroid", "all"]
    assert [int(row[1]) for row in rows] == [2, 1, 3]
    assert all(0.0 <= float(row[4]) <= 1.0 for row in rows)
    print_landmarks([str(config), "--workers", "1", "--each"])
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()[2:]]
    assert sorted(int(row[0]) for row in rows) == [0, 1, 2]
    across = [int(row[3]) for row in rows]
    assert across == sorted(across)
    assert all(60 < each < 160 for each in across)
    with pytest.raises(SystemExit) as refused:
        print_landmarks([str(tmp_path / "none.yaml")])
    assert refused.value.code == 2
