"""The page stays within its size, however long the run and however many its pictures; no peak is lost."""

import io
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from polhode.records.surface import SurfaceModel
from polhode.report.page import render
from polhode.report.page_pictures import MAX_FILM_FRAMES, embed_pictures, film_frames
from polhode.report.page_size import (
    CLOUD_FACTOR,
    FIGURE_BYTES,
    PAGE_BYTES,
    THINNED_NOTE,
    extremes,
    figures_within,
    with_fewer_points,
)
from polhode.report.plot_style import Figure, band, layout, line, points3d
from polhode.report.template import figure_text
from polhode.run_directory.film import StoredFilm
from polhode.run_directory.stored_run import StoredPicture, StoredRun, read_stored_run
from tests.pipeline.stored_run import stored
from tests.report.test_convergence import online_of
from tests.report.test_film_and_timeline import gif

FRAMES = 2000


def _noise(width: int, height: int, seed: int) -> bytes:
    """A picture that compresses badly."""
    stream = io.BytesIO()
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def _tiled(record: Any, count: int, frames: int) -> Any:
    """The record with ``frames`` frames instead of ``count``: its own, repeated, and noise."""
    random = np.random.default_rng(3)
    values = {}
    for each in fields(record):
        value = getattr(record, each.name)
        if isinstance(value, np.ndarray) and len(value) == count and each.name != "timestamps_ns":
            repeated = np.resize(value, (frames, *value.shape[1:]))
            if repeated.dtype == np.float64 and repeated.ndim == 2:
                repeated = repeated * random.uniform(0.99, 1.01, repeated.shape)
            values[each.name] = repeated
        elif each.name == "timestamps_ns":
            values[each.name] = value[0] + np.arange(frames, dtype=np.int64) * 500_000_000
    return replace(record, **values)


@pytest.fixture(scope="module")
def long_run(example: Any, tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    """A run of ``FRAMES`` frames with a dense mesh, a film and pictures, all of noise."""
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    sphere.vertices *= np.random.default_rng(1).uniform(0.95, 1.05, (len(sphere.vertices), 1))
    count = len(sphere.vertices)
    surface = SurfaceModel(sphere, np.full(count, 1e-3), np.ones(count, dtype=np.int64))
    folder = stored(tmp_path_factory.mktemp("long") / "run", example, surface, online_of(example.estimate))
    run = read_stored_run(folder, "long")
    assert run.motion is not None and run.tracks is not None and run.residuals is not None
    assert run.online is not None and run.landmarks is not None
    short, tracks = run.tracks.n_frames, run.tracks
    rounds = FRAMES // short
    trajectory = _tiled(run.motion.trajectory, short, FRAMES)
    copies = [tracks.frame + k * short for k in range(rounds)]
    tracks = replace(
        _tiled(tracks, short, FRAMES), frame=np.concatenate(copies),
        landmark=np.tile(tracks.landmark, rounds),
        uvd_px=np.tile(tracks.uvd_px, (rounds, 1)), sigma_px=np.tile(tracks.sigma_px, (rounds, 1)),
    )  # fmt: skip
    residuals = replace(
        run.residuals,
        residuals_px=np.tile(run.residuals.residuals_px, (rounds, 1)),
        inlier_weight=np.tile(run.residuals.inlier_weight, rounds),
    )
    names = [*(f"{k:02d}.png" for k in range(24)), *(f"model_{k:04d}.png" for k in range(4)), "mesh.png"]
    pictures = tuple(StoredPicture(name, f"of {name}", _noise(240, 160, k)) for k, name in enumerate(names))
    return replace(
        run,
        motion=replace(
            run.motion, trajectory=trajectory, covariance=_tiled(run.motion.covariance, short, FRAMES)
        ),
        online=_tiled(run.online, short, FRAMES),
        tracks=tracks,
        residuals=residuals,
        pictures=pictures,
        film=StoredFilm(gif(6), tuple(range(0, 1800, 300))),
        config_text=run.config_text,
    )


def test_a_run_of_thousands_of_frames_stays_within_the_size(long_run: StoredRun) -> None:
    page = render(long_run)
    assert 0.9 * PAGE_BYTES < len(page.encode()) <= PAGE_BYTES
    assert THINNED_NOTE.strip() in page
    assert page.count("data:image/webp") > 8 and "Model beside the images" in page


def test_long_words_take_the_place_of_pictures(long_run: StoredRun) -> None:
    words = json.dumps(np.random.default_rng(2).integers(0, 10**9, 30_000).tolist())
    assert len(words) > 300_000
    pages = [render(replace(long_run, config_text=words[:count])) for count in (0, 300_000)]
    assert all(len(page.encode()) <= PAGE_BYTES for page in pages)
    assert "data:image/webp" in pages[1] and words[:300_000] in pages[1]


def test_pictures_become_smaller_and_then_fewer(long_run: StoredRun) -> None:
    sizes = [len(embed_pictures(long_run.pictures, most)) for most in (10**9, 150_000, 20_000, 0)]
    assert sizes[0] == len(long_run.pictures) and sizes[1] > sizes[2] > sizes[3] == 0
    for most in (150_000, 20_000):
        assert sum(len(each.uri) for each in embed_pictures(long_run.pictures, most)) <= most
    film = long_run.film
    frames = film_frames(film, 300_000)
    assert 0 < len(frames) < len(film_frames(film, 10**9)) == 6 and film_frames(film, 0) == []
    assert frames[0].frame == 0 and sum(len(each.uri) for each in frames) <= 300_000
    assert film is not None
    long = StoredFilm(gif(2 * MAX_FILM_FRAMES), tuple(range(2 * MAX_FILM_FRAMES)))
    chosen = [each.frame for each in film_frames(long, 10**9)]
    assert len(chosen) == MAX_FILM_FRAMES and (chosen[0], chosen[-1]) == (0, 2 * MAX_FILM_FRAMES - 1)


def test_a_curve_keeps_its_ends_its_peaks_and_its_gaps() -> None:
    values = np.sin(np.linspace(0.0, 20.0, 5000))
    values[1234], values[4321] = 7.0, -9.0
    values[2000:2400] = np.nan
    kept = extremes(values, 200)
    assert len(kept) <= 200 and kept[0] == 0 and kept[-1] == 4999
    assert {1234, 4321} <= set(kept.tolist())
    inside = values[kept[(kept >= 2000) & (kept < 2400)]]
    assert len(inside) >= 5 and np.all(np.isnan(inside))
    np.testing.assert_array_equal(extremes(values[:150], 200), np.arange(150))


def test_a_band_keeps_its_shape_and_a_cloud_its_colours() -> None:
    x = np.arange(3000.0)
    half = 1.0 + 0.1 * np.sin(x)
    half[500] = 30.0
    cloud = points3d(np.stack([x, x, x], axis=1), "cloud", marker={"color": x, "size": 2})
    figure = Figure(
        "key", "", "", [*band(x, 0.0 * x, half, "#112233"), line(x, x, "line", "#112233"), cloud], layout()
    )
    outline, curve, points = with_fewer_points(figure, 100).data
    edge_x, edge_y = outline["x"], outline["y"]
    assert len(edge_x) <= 200 and edge_x[0] == edge_x[-1] == 0.0 and edge_x.max() == 2999.0
    assert {30.0, -30.0} <= set(edge_y.tolist())
    assert len(curve["y"]) <= 100
    assert len(points["x"]) == 100 * CLOUD_FACTOR
    np.testing.assert_array_equal(points["marker"]["color"], points["x"])


def test_figures_of_a_long_run_are_within_their_size(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    x = np.arange(20_000.0)
    figures = [
        Figure(str(k), "", "", [line(x, random.standard_normal(len(x)), "line", "#112233")], layout())
        for k in range(12)
    ]
    assert figures_within(figures[:1], figure_text) == figures[:1], "few points stay as they are"
    thinned = figures_within(figures, figure_text)
    assert sum(len(figure_text(each)) for each in thinned) <= FIGURE_BYTES
    for before, after in zip(figures, thinned, strict=True):
        for extreme in (np.max, np.min):
            assert extreme(after.data[0]["y"]) == extreme(before.data[0]["y"])
