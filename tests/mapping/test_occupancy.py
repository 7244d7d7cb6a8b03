"""What outlines show and the mesh lacks, and what no frame excludes: against the body that was rendered."""

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.mapping import occupancy as module
from polhode.mapping.occupancy import occupancy_of
from polhode.mapping.visibility import FrameView, MeshViewer
from polhode.records.occupancy import EMPTY, FREE, OUTLINED, POSSIBLE, Occupancy
from polhode.records.surface import DepthMap
from tests.mapping.rendered_views import RIG, rendered, tumbling


def union(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """One mesh of several, which may overlap."""
    joined = trimesh.util.concatenate(list(meshes))
    assert isinstance(joined, trimesh.Trimesh)
    return joined


BOX = trimesh.creation.box((0.06, 0.05, 0.04)).subdivide_to_size(0.004)
BOOM = trimesh.creation.box((0.002, 0.002, 0.06))
BOOM.apply_translation((0.02, 0.01, 0.05))
WHOLE = union(BOX, BOOM)
SUN_N = np.array([0.2, -0.3, -0.93])


def views_of(mesh: trimesh.Trimesh, frames: int, sun_N: Array = SUN_N) -> list[FrameView]:
    """Frames by the camera; the target's mask is what is lit."""
    views = [rendered(mesh, X, sun_N, lambda p: 150 + 0 * p[:, 0], 0.02) for X in tumbling(frames)]
    return [
        FrameView(each.image, each.image > 0, each.X_RG, each.R_NR, lit_above=12.0, frame=n)
        for n, each in enumerate(views)
    ]


def depth_of(mesh: trimesh.Trimesh, view: FrameView) -> DepthMap:
    """What stereo measures of a mesh: nothing where it is dark."""
    seen = MeshViewer(mesh).perspective(RIG, view.X_RG, np.arange(RIG.width_px), np.arange(RIG.height_px))
    depth = np.where(view.silhouette, seen.depth_m, np.nan).astype(np.float32)
    return DepthMap(depth, np.where(np.isfinite(depth), 5e-4, np.nan), view.image, view.silhouette)


def found(mesh: trimesh.Trimesh, views: list[FrameView], sun_N: Array | None = SUN_N) -> Occupancy:
    return occupancy_of(mesh, views, (depth_of(mesh, each) for each in views), RIG, sun_N)


def states(occupied: Occupancy, places: Array) -> Array:
    return np.asarray(occupied.states_at(np.asarray(places, dtype=np.float64)))


def test_a_boom_that_stereo_missed_is_outlined_and_the_sky_around_it_is_free() -> None:
    occupied = found(BOX, views_of(WHOLE, 20))
    along = np.array([[0.02, 0.01, z] for z in np.linspace(0.035, 0.075, 9)])
    assert (states(occupied, along) == OUTLINED).mean() > 0.8
    beside = along + np.array([0.015, 0.0, 0.0])
    assert (states(occupied, beside) == EMPTY).all()
    outlined = occupied.centres(OUTLINED)
    # about as far from the boom as the blur of an edge reaches
    pixel_m = 0.5 / RIG.focal_px
    away = np.linalg.norm((outlined - (0.02, 0.01, 0.05))[:, :2], axis=1)
    assert np.median(away) < (module.BLUR_PX + 1.0) * pixel_m + occupied.step_m
    assert occupied.step_m**3 * len(outlined) < 0.2 * BOX.volume
    # of the cells on a ray those count that most frames agree on
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SHARE_OF_RAY", 0.0)
        every = found(BOX, views_of(WHOLE, 20)).centres(OUTLINED)
    spread = np.linalg.norm((every - (0.02, 0.01, 0.05))[:, :2], axis=1)
    assert len(outlined) < len(every) and away.max() < spread.max()
    # the same again: nothing is drawn at random
    np.testing.assert_array_equal(found(BOX, views_of(WHOLE, 20)).state, occupied.state)


def test_an_antenna_thinner_than_a_cell_that_not_all_frames_show_is_outlined() -> None:
    """In the others it is dark before the sky; a cell is three times as wide as the antenna."""
    lit, dark = views_of(WHOLE, 20), views_of(BOX, 20)
    views = [lit[n] if n % 2 == 0 else dark[n] for n in range(20)]
    along = np.array([[0.02, 0.01, z] for z in np.linspace(0.035, 0.075, 9)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_CELLS_ALONG", 24)
        coarse = found(BOX, views)
        assert coarse.step_m > 0.005
        assert (states(coarse, along) == OUTLINED).mean() > 0.5
        # as the pixel at the middle of a cell says
        patch.setattr(module._Picture, "see_in_cells", lambda *_: None)
        assert (states(found(BOX, views), along) == OUTLINED).mean() == 0.0


def test_a_panel_whose_dark_side_most_frames_show_is_outlined() -> None:
    """In light from the side, 7 of 24 frames show the lit side of the panel above a body that turns."""
    panel = trimesh.creation.box((0.05, 0.05, 0.0012))
    panel.apply_translation((0.0, 0.055, 0.0))
    turns = np.deg2rad(np.concatenate([np.linspace(105.0, 150.0, 7), np.linspace(200.0, 250.0, 17)]))
    sun_N, views = np.array([1.0, 0.0, 0.0]), []
    for n, turn in enumerate(turns):
        X = make_pose(exp_so3([0.0, turn, 0.0]), np.array([0.0, 0.0, 0.5]))
        seen = rendered(union(BOX, panel), X, sun_N, lambda p: 150 + 0 * p[:, 0])
        views.append(FrameView(seen.image, seen.image > 0, X, seen.R_NR, lit_above=12.0, frame=n))
    places = np.array(
        [[x, y, 0.0] for x in np.linspace(-0.02, 0.02, 6) for y in np.linspace(0.035, 0.075, 7)]
    )
    assert (states(found(BOX, views, sun_N), places) == OUTLINED).all()
    # without a word on the Sun, the frames that show its dark side seem to show the sky
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_lit_and_seen", lambda *_: np.zeros(0, dtype=np.uint64))
        assert (states(found(BOX, views, sun_N), places) == OUTLINED).mean() < 0.5


def test_of_the_cells_on_a_ray_those_count_that_agree_most_and_are_near_the_surface() -> None:
    """Frames that all see the cells on one ray; others that see a cell of their own beside the last one."""

    def frame(shift_m: float = 0.0) -> module._Picture:
        picture = module._Picture.__new__(module._Picture)
        picture.kind = np.full((41, 41), module.TARGET, dtype=np.uint8)
        sees_all = np.full((41, 41), np.inf, dtype=np.float32)
        X = np.eye(4)
        X[0, 3] = shift_m
        pinhole = np.array([100.0, 20.0, 20.0, 0.0, 0.0, 0.0, 0.0])
        picture.parts = (X, pinhole, sees_all, -sees_all, picture.kind)
        return picture

    step_m, z = 0.01, np.array([1.0, 1.1, 1.2, 1.3, 1.4])
    p_G = np.column_stack([0.0 * z, 0.0 * z, z])
    away_m, share = z - 0.9, np.array([1.0, 1.0, 1.0, 1.0, 0.5], dtype=np.float32)
    agree = module._explains(p_G, share, away_m, step_m, [frame(), frame()])
    reach_m = module.NEAREST_OF_RAY * away_m[0] + module.MORE_CELLS * step_m
    np.testing.assert_array_equal(agree, (away_m <= reach_m) & (share == 1.0))
    assert 0 < agree.sum() < 4 and not module._explains(p_G, share, away_m, step_m, [frame()]).any()
    # from elsewhere the rays to the near cell and to the last one, on which all agree, are apart
    share[-1] = 1.0
    for others in (1, 2, 3):
        agree = module._explains(p_G, share, away_m, step_m, [*([frame()] * 2), *([frame(0.15)] * others)])
        assert agree[0] and agree[-1] == (others >= 2)


def test_a_side_that_is_never_lit_stays_possible_within_the_hull() -> None:
    """The light is fixed to the body, as of one that always shows the Sun the same side."""
    sun_G = np.array([0.0, 0.0, 1.0])
    views = []
    for n, X in enumerate(tumbling(20)):
        # these axes of the camera in N keep the body at rest in N
        seen = rendered(BOX, X, X[:3, :3] @ sun_G, lambda p: 150 + 0 * p[:, 0])
        views.append(FrameView(seen.image, seen.image > 0, X, X[:3, :3].T, lit_above=12.0, frame=n))
    lit = BOX.submesh([np.flatnonzero(BOX.face_normals[:, 2] > 0.5)], append=True)
    walls = BOX.submesh([np.flatnonzero(np.abs(BOX.face_normals[:, 1]) > 0.5)], append=True)
    surface = union(lit, walls)
    dark = np.array([[x, y, -0.015] for x in (-0.02, 0.0, 0.02) for y in (-0.015, 0.0, 0.015)])
    occupied = found(surface, views, sun_G)
    assert (states(occupied, dark) == POSSIBLE).all()
    assert (states(occupied, dark - np.array([0.0, 0.0, 0.03])) == FREE).all(), "beyond the hull"


def test_frames_in_shadow_and_masks_that_failed_exclude_and_show_nothing() -> None:
    views = views_of(WHOLE, 20)
    whole = found(BOX, views)
    dark, full = np.zeros_like(views[0].image), np.ones_like(views[0].silhouette)
    eclipsed = [FrameView(dark, ~full, each.X_RG, each.R_NR) for each in views[:8]]
    failed = [FrameView(views[0].image, full, each.X_RG, each.R_NR) for each in views[:2]]
    # stereo measures nothing in the shadow, nor where the masks are wrong
    shown = [*views, *eclipsed, *eclipsed[:2]]
    depths = [depth_of(BOX, each) for each in shown]
    more = occupancy_of(BOX, [*views, *eclipsed, *failed], depths, RIG, SUN_N)
    assert more.step_m == pytest.approx(whole.step_m, rel=0.1)
    matter, whole_matter = (np.isin(each.state, (OUTLINED, POSSIBLE)) for each in (more, whole))
    assert (matter != whole_matter).sum() < 0.02 * whole_matter.sum() + 50
    with pytest.raises(ValueError, match="no frames"):
        occupancy_of(BOX, [], [], RIG, SUN_N)
