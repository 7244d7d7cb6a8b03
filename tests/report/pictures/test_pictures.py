"""RUN/pictures: what is drawn says what is true, files open and have their sizes, nothing breaks a run."""

import csv
import io
import json
import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

from polhode.config import Config
from polhode.files.output.run_files import is_run_file
from polhode.frontend.found_masks import FoundMasks, MaskQuality, encoded
from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import inverse_pose
from polhode.mapping.visibility import Caster, MeshViewer
from polhode.pipeline import write_results as pictures
from polhode.pipeline.context import RunContext
from polhode.records.dataset import StereoImages, StereoSequence
from polhode.report.pictures.body_views import (
    ALONG_AXES,
    OBLIQUE,
    body_frame,
    round_length_mm,
)
from polhode.report.pictures.mask_strip import DOUBTFUL_BGR, OUTLINE_BGR, draw_outline, frames_to_show
from polhode.report.pictures.model_comparison import (
    MAX_GIF_BYTES,
    SIZE_PX,
    FrameComparison,
    chosen_frames,
    compare_frames,
    draw_frame,
    film,
    fit_brightness,
)
from polhode.report.shape_figures import vertex_rgb
from polhode.runtime.progress import Silent

FRAMES = 5
EMPTY = trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), process=False)


class Rendered:
    """A sequence whose images are the model itself, with a gain and an offset, at the estimated poses."""

    def __init__(self, run: Any) -> None:
        rig = run.tracks.rig
        viewer, colours = MeshViewer(run.surface.mesh), vertex_rgb(run.surface.mesh).mean(axis=1)
        self.images = []
        for X_RG in inverse_pose(run.tracks.X_NR) @ run.estimate.X_NG:
            view = viewer.perspective(rig, X_RG, np.arange(rig.width_px), np.arange(rig.height_px))
            grey = np.where(view.hit, 0.7 * view.values(colours) + 20.0, 0.0)
            self.images.append((np.round(grey).astype(np.uint8), view.hit))

    def read_pair(self, k: int) -> StereoImages:
        image, mask = self.images[k]
        return StereoImages(image, image, mask, mask)

    def read_left(self, k: int) -> tuple[Any, Any]:
        return self.images[k]


@pytest.fixture(scope="module")
def run(example: Any) -> Any:
    """The first frames of the example, with a mesh of smooth brightness and images that show just that."""
    tracks, estimate, mesh = example.tracks, example.estimate, example.surface.mesh.copy()
    here = tracks.frame < FRAMES
    rows = {name: getattr(tracks, name)[here] for name in ("frame", "landmark", "uvd_px", "sigma_px")}
    frames = {name: getattr(tracks, name)[:FRAMES] for name in ("timestamps_ns", "X_NR")}
    tracks = replace(tracks, **rows, **frames)
    rows = {name: getattr(estimate, name)[here] for name in ("inlier_weight", "residuals_px")}
    estimate = replace(estimate, X_NG=estimate.X_NG[:FRAMES], **rows)
    grey = (120 + 400 * mesh.vertices[:, [0]] + 300 * mesh.vertices[:, [2]]).astype(np.uint8)
    mesh.visual.vertex_colors = np.hstack([grey, grey, grey, np.full_like(grey, 255)])
    surface = replace(example.surface, mesh=mesh)
    seen = SimpleNamespace(tracks=tracks, estimate=estimate, surface=surface)
    seen.sequence = cast(StereoSequence, Rendered(seen))
    size = tracks.rig.width_px, tracks.rig.height_px
    seen.rectifier = Rectifier(tracks.rig, np.eye(4), None, (size, size))
    return seen


def make(run: Any, folder: Path, **changed: Any) -> set[str]:
    """Names of the pictures that come out."""
    given = {"estimate": run.estimate, "surface": run.surface} | changed
    context = RunContext(run.sequence, run.rectifier, Config(), Silent())
    motion: Any = SimpleNamespace(tracks=run.tracks, estimate=given["estimate"])
    coloured: Any = SimpleNamespace(surface=given["surface"], sun_N=None)
    pictures.write_pictures.make(context, folder, motion, coloured)
    place = folder / "pictures"
    return {file.name for file in place.iterdir() if not file.name[0].isdigit()}


def comparisons(run: Any) -> list[FrameComparison]:
    given = (run.sequence, run.rectifier, run.tracks, run.estimate, run.surface.mesh)
    return list(compare_frames(*given, list(range(FRAMES))))


def test_the_same_image_leaves_no_difference_beside_frames_without_the_body_in_view(run: Any) -> None:
    same = comparisons(run)
    X_NG = run.estimate.X_NG.copy()
    X_NG[1, :3, 3] = 0.2, 0.0, 0.12  # beside the camera
    X_NG[2, :3, 3] = 0.0, 0.0, -1.0  # behind it
    found = comparisons(SimpleNamespace(**{**vars(run), "estimate": replace(run.estimate, X_NG=X_NG)}))
    assert [each.image.shape for each in found] == [each.image.shape for each in same]
    assert not found[2].modelled.any() and found[3].overlap > 0.985
    for comparison in same:
        assert comparison.overlap > 0.985
        assert comparison.rms_grey < 1.0
        assert comparison.gain == pytest.approx(0.7, abs=0.02)
        assert comparison.offset == pytest.approx(20.0, abs=2.0)
        inside = comparison.seen & comparison.modelled
        assert np.abs(comparison.difference[inside]).max() < 6.0


def test_the_body_casts_its_shadow_on_itself(run: Any) -> None:
    """A small plate between box and Sun darkens the side that it stands before, and no other."""
    box = run.surface.mesh
    side = np.array([0.0, 0.0, -1.0])  # of G; the camera looks at it in frame 0, where G is upright in N
    plate = trimesh.creation.box((0.05, 0.05, 0.004))
    plate.apply_translation(0.16 * side)
    corners = np.vstack([box.vertices, plate.vertices])
    faces = np.vstack([box.faces, plate.faces + len(box.vertices)])
    grey = np.tile(np.array([200, 200, 200, 255], dtype=np.uint8), (len(corners), 1))
    body = trimesh.Trimesh(corners, faces, vertex_colors=grey, process=False)
    given = (run.sequence, run.rectifier, run.tracks, run.estimate, body, [0])
    # From beside the camera, so that the shadow lies beside the plate.
    sun_N = np.array([-0.5, 0.0, -1.0]) / np.linalg.norm([-0.5, 0.0, -1.0])
    plain, shaded = (next(compare_frames(*given, sun_N=sun_N, caster=each)) for each in (None, Caster(body)))
    darker = plain.modelled & (shaded.model < 0.1 * plain.model)
    share = darker.sum() / plain.modelled.sum()
    assert 0.02 < share < 0.3
    columns = np.flatnonzero(darker.any(axis=0))
    assert columns.mean() > 0.5 * plain.model.shape[1], "away from the Sun, which stands at the left"


def test_overlap_and_difference_of_known_squares() -> None:
    seen, modelled = np.zeros((10, 10), dtype=bool), np.zeros((10, 10), dtype=bool)
    seen[:, :6], modelled[:, 3:9] = True, True
    image = np.where(seen, 100, 0).astype(np.uint8)
    model = np.where(modelled, 50.0, 0.0)
    comparison = FrameComparison(3, 1.5, True, image, model, seen, modelled, 1.0, 20.0)
    assert comparison.overlap == pytest.approx(30 / 90)
    assert comparison.covered == pytest.approx(30 / 60)
    assert comparison.rms_grey == pytest.approx(30.0)
    np.testing.assert_array_equal(comparison.difference[0], [100, 100, 100, 30, 30, 30, -70, -70, -70, 0])
    nothing = replace(comparison, seen=np.zeros_like(seen), modelled=np.zeros_like(seen))
    assert np.isnan(nothing.overlap) and np.isnan(nothing.rms_grey)
    assert draw_frame(nothing, 5).shape == (SIZE_PX[1], SIZE_PX[0], 3)


def test_gain_and_offset_are_those_of_least_squares_and_frames_are_spread_evenly() -> None:
    model = np.linspace(10.0, 90.0, 50)
    gain, offset = fit_brightness((2.0 * model + 15.0).astype(np.uint8), model)
    assert gain == pytest.approx(2.0, abs=0.01) and offset == pytest.approx(15.0, abs=1.0)
    # never negative
    gain, offset = fit_brightness((200.0 - model).astype(np.uint8), model)
    assert gain == 0.0 and offset == pytest.approx(149.5, abs=1.0)
    assert fit_brightness(np.zeros(0, dtype=np.uint8), np.zeros(0)) == (1.0, 0.0)
    assert chosen_frames(115, 60)[:3] == [0, 2, 4] and chosen_frames(115, 60)[-1] == 114
    assert len(chosen_frames(1000, 60)) == 60
    assert chosen_frames(3, 60) == [0, 1, 2] and chosen_frames(10, 1) == [0]


def test_every_direction_is_a_right_handed_view_from_the_side_that_it_names(
    example: Any, undetermined: Any
) -> None:
    for direction in (*ALONG_AXES, *OBLIQUE):
        signs = {
            name: (-1 if part[0] == "\u2212" else 1) for part in direction.name.split() for name in part[1]
        }
        expected = np.array([signs.get(name, 0) for name in "xyz"])
        np.testing.assert_allclose(direction.eye, expected / np.linalg.norm(expected), atol=1e-12)
    # a scale bar has a round length
    assert [round_length_mm(size) for size in (300.0, 160.0, 32.0, 0.7)] == [100.0, 50.0, 10.0, 0.2]
    # the frame of the views is P where it is known, and G elsewhere
    mass = example.estimate.mass
    known = body_frame(mass)
    assert known.name == "P"
    np.testing.assert_allclose(known.points(mass.com_G[None]), 0.0, atol=1e-15)
    other = body_frame(undetermined.estimate.mass)
    assert other.name == "G" and "not fully determined" in other.description
    np.testing.assert_array_equal(other.R_GA, np.eye(3))


def test_all_files_are_there_open_and_have_their_sizes(run: Any, tmp_path: Path) -> None:
    names = make(run, tmp_path)
    place, again = tmp_path / "pictures", tmp_path / "again"
    again.mkdir()
    make(run, again)
    for file in place.iterdir():
        assert file.read_bytes() == (again / "pictures" / file.name).read_bytes(), file.name
    stills = {f"model_{k:04d}.jpg" for k in (0, 1, 3, 4)}
    assert names == {
        "mesh.png", "model.mp4", "model.gif", "model.csv", "captions.json", *stills,
    }  # fmt: skip
    video = cv2.VideoCapture(str(place / "model.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == SIZE_PX
    assert video.read()[0]
    with Image.open(place / "model.gif") as gif:
        assert getattr(gif, "n_frames", 1) == FRAMES
        assert gif.width == round(0.75 * SIZE_PX[0])
    assert (place / "model.gif").stat().st_size <= MAX_GIF_BYTES
    with Image.open(place / "mesh.png") as picture:
        picture.load()
        assert picture.width > 1500
    rows = list(csv.DictReader(io.StringIO((place / "model.csv").read_text())))
    assert [int(row["frame"]) for row in rows] == list(range(FRAMES))
    assert all(float(row["iou"]) > 0.985 and row["measured"] == "1" for row in rows)
    captions = json.loads((place / "captions.json").read_text())
    assert set(captions) == {file.name for file in place.iterdir()} - {
        "captions.json", "model.mp4", "model.gif", "model.csv",
    }  # fmt: skip


def test_a_picture_that_cannot_be_made_costs_only_itself(
    run: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "off").mkdir()
    nothing = replace(run.surface, mesh=EMPTY, sigma_m=np.zeros(0), views=np.zeros(0, dtype=np.int64))
    assert make(run, tmp_path / "off", surface=nothing) == {"captions.json"}
    assert not caplog.records

    def fail(*_: Any) -> bytes:
        raise RuntimeError("no ink")

    monkeypatch.setattr(pictures, "draw_mesh", fail)
    monkeypatch.setattr(pictures, "draw_frame", fail)
    with caplog.at_level(logging.WARNING):
        assert make(run, tmp_path) == {"captions.json"}
    assert [record.getMessage() for record in caplog.records] == [
        "no picture: mesh.png (RuntimeError: no ink)",
        "no picture: model.mp4 (RuntimeError: no ink)",
    ]


def test_a_gif_that_grows_too_large_keeps_fewer_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("polhode.report.pictures.model_comparison.MAX_GIF_BYTES", 1_000_000)
    random = np.random.default_rng(0)
    with film(tmp_path / "a.mp4", tmp_path / "a.gif") as add:
        for _ in range(16):
            add(random.integers(0, 255, (SIZE_PX[1], SIZE_PX[0], 3), dtype=np.uint8))
    with Image.open(tmp_path / "a.gif") as gif:
        assert getattr(gif, "n_frames", 1) == 8
        assert gif.info["duration"] == 200


def test_masks_that_were_found_are_shown_in_a_picture(run: Any, tmp_path: Path) -> None:
    masks = {k: (encoded(run.sequence.images[k][1]),) * 2 for k in range(FRAMES)}
    good = MaskQuality(area=0.1, agreement=0.98, contradicted=0.02, far_share=0.95)
    found = FoundMasks(masks, dict.fromkeys(range(FRAMES), good))
    masked = SimpleNamespace(**vars(run) | {"rectifier": replace(run.rectifier, found=found)})
    assert "masks.jpg" in make(masked, tmp_path)
    captions = json.loads((tmp_path / "pictures" / "captions.json").read_text())
    assert captions["masks.jpg"].endswith("5 of 5 frames. Doubtful (red): 0.")
    assert is_run_file("pictures/masks.jpg")
    # spread over the sequence, doubtful ones among them
    assert frames_to_show(list(range(5)), set()) == [0, 1, 2, 3, 4]
    shown = frames_to_show(list(range(71)), {13, 14})
    assert len(shown) == 8 and {13, 14} <= set(shown)
    crowded = frames_to_show(list(range(71)), set(range(20, 60)))
    assert len(crowded) == 8 and crowded[0] == 0 and crowded[-1] == 70
    mask = np.zeros((240, 320), dtype=bool)
    mask[80:160, 100:200] = True
    for doubtful, colour in ((False, OUTLINE_BGR), (True, DOUBTFUL_BGR)):
        tile = draw_outline(np.full((240, 320), 100, dtype=np.uint8), mask, "frame 3", doubtful)
        np.testing.assert_allclose(tile[120, 100], colour, atol=3)
        assert tile[120, 150].tolist() == [100] * 3 and tile[200, 150].tolist() == [55] * 3
