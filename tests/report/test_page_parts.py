"""Parts of the page: its size, no peak lost, what the slider moves, texts and arrays as it holds them."""

import base64
import io
import json
import re
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from polhode.records.surface import SurfaceModel
from polhode.report.page import camera_views, render, timeline
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
from polhode.report.plot_style import Figure, band, layout, line, packed, points3d, scene_layout
from polhode.report.template import css_text, deflated, figure_text, inflated
from polhode.run_directory.film import StoredFilm, read_film
from polhode.run_directory.stored_run import StoredPicture, StoredRun, read_stored_run
from tests.pipeline.stored_run import stored
from tests.report.conftest import online_of, png, unpacked

FRAMES = 2000


def gif(count: int, size: tuple[int, int] = (303, 732)) -> bytes:
    """Noise, which compresses badly."""
    noise = np.random.default_rng(1).integers(0, 256, (count, *size), dtype=np.uint8)
    pictures = [Image.fromarray(each).convert("P") for each in noise]
    stream = io.BytesIO()
    pictures[0].save(stream, "GIF", save_all=True, append_images=pictures[1:])
    return stream.getvalue()


def pictures_of_noise() -> tuple[StoredPicture, ...]:
    names = [*(f"{k:02d}.png" for k in range(12)), "model_0000.png", "mesh.png"]
    pixels = np.random.default_rng(0).integers(0, 256, (len(names), 240, 160), dtype=np.uint8)
    return tuple(StoredPicture(name, name, png(each)) for name, each in zip(names, pixels, strict=True))


def longer(record: Any, count: int) -> Any:
    """The record with ``FRAMES`` frames instead of ``count``: its own, repeated, and noise."""
    random, values = np.random.default_rng(3), {}
    for name in (each.name for each in fields(record)):
        value = getattr(record, name)
        if name == "timestamps_ns":
            values[name] = value[0] + np.arange(FRAMES, dtype=np.int64) * 500_000_000
        elif isinstance(value, np.ndarray) and len(value) == count:
            repeated = np.resize(value, (FRAMES, *value.shape[1:]))
            is_noisy = repeated.dtype == np.float64 and repeated.ndim == 2
            values[name] = repeated * random.uniform(0.99, 1.01, repeated.shape) if is_noisy else repeated
    return replace(record, **values)


def test_a_run_of_thousands_of_frames_with_long_words_stays_within_the_size(
    example: Any, tmp_path: Path
) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    sphere.vertices *= np.random.default_rng(1).uniform(0.95, 1.05, (len(sphere.vertices), 1))
    count = len(sphere.vertices)
    surface = SurfaceModel(sphere, np.full(count, 1e-3), np.ones(count, dtype=np.int64))
    run: Any = read_stored_run(stored(tmp_path, example, surface, online_of(example.estimate)), "long")
    short, tracks, rounds = run.tracks.n_frames, run.tracks, FRAMES // run.tracks.n_frames
    tracks = replace(
        longer(tracks, short), frame=np.concatenate([tracks.frame + k * short for k in range(rounds)]),
        landmark=np.tile(tracks.landmark, rounds), uvd_px=np.tile(tracks.uvd_px, (rounds, 1)),
        sigma_px=np.tile(tracks.sigma_px, (rounds, 1)),
    )  # fmt: skip
    residuals = replace(
        run.residuals, residuals_px=np.tile(run.residuals.residuals_px, (rounds, 1)),
        inlier_weight=np.tile(run.residuals.inlier_weight, rounds),
    )  # fmt: skip
    motion = {name: longer(getattr(run.motion, name), short) for name in ("trajectory", "covariance")}
    words = json.dumps(np.random.default_rng(2).integers(0, 10**9, 30_000).tolist())[:100_000]
    page = render(
        replace(
            run, motion=replace(run.motion, **motion), online=longer(run.online, short), tracks=tracks,
            residuals=residuals, pictures=pictures_of_noise(), config_text=words,
            film=StoredFilm(gif(3), (0, 300, 600)),
        )
    )  # fmt: skip
    assert 0.85 * PAGE_BYTES < len(page.encode()) <= PAGE_BYTES
    assert THINNED_NOTE.strip() in page and words in page
    assert page.count("data:image/webp") > 4 and "Model beside the images" in page


def test_pictures_become_smaller_and_then_fewer() -> None:
    pictures = pictures_of_noise()
    sizes = {}
    for most in (10**9, 150_000, 20_000, 0):
        found = embed_pictures(pictures, most)
        sizes[most] = len(found)
        assert sum(len(each.uri) for each in found) <= most
    assert sizes[10**9] == len(pictures) and sizes[150_000] > sizes[20_000] > sizes[0] == 0
    noisy = StoredFilm(gif(3), (0, 300, 600))
    frames = film_frames(noisy, 150_000)
    assert 0 < len(frames) < len(film_frames(noisy, 10**9)) == 3 and film_frames(noisy, 0) == []
    assert frames[0].frame == 0 and sum(len(each.uri) for each in frames) <= 150_000
    long = StoredFilm(gif(2 * MAX_FILM_FRAMES, (20, 30)), tuple(range(2 * MAX_FILM_FRAMES)))
    chosen = [each.frame for each in film_frames(long, 10**9)]
    assert len(chosen) == MAX_FILM_FRAMES and (chosen[0], chosen[-1]) == (0, 2 * MAX_FILM_FRAMES - 1)


def test_frames_of_the_film_are_those_of_its_table_and_a_damaged_one_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert read_film(tmp_path) is None and film_frames(None) == [] and caplog.text == ""
    # the table has twice as many rows: the GIF shows every second frame
    three = gif(3)
    frames = film_frames(StoredFilm(three, (10, 11, 12, 13, 14)), 10**9)
    assert [each.frame for each in frames] == [10, 12, 14]
    with Image.open(io.BytesIO(base64.b64decode(frames[0].uri.partition(",")[2]))) as picture:
        assert picture.format == "WEBP" and picture.size == (732, 240)
    assert film_frames(StoredFilm(three, (10, 11))) == [] and "3 pictures" in caplog.text
    assert film_frames(StoredFilm(b"GIF89a, cut off", (1, 2))) == []
    (tmp_path / "model.gif").write_bytes(three)
    (tmp_path / "model.csv").write_text("frame,sunlit\n7,1\n")
    found = read_film(tmp_path)
    assert found is not None and found.frames == (7,) and found.sunlit
    (tmp_path / "model.csv").write_text("frame\nseven\n")
    assert read_film(tmp_path) is None and "is damaged and is left out" in caplog.text


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


def test_a_band_keeps_its_shape_a_cloud_its_colours_and_figures_their_size() -> None:
    x = np.arange(3000.0)
    half = 1.0 + 0.1 * np.sin(x)
    half[500] = 30.0
    cloud = points3d(np.stack([x, x, x], axis=1), "cloud", marker={"color": x, "size": 2})
    data = [*band(x, 0.0 * x, half, "#112233"), line(x, x, "line", "#112233"), cloud]
    outline, curve, points = with_fewer_points(Figure("key", "", "", data, layout()), 100).data
    assert len(outline["x"]) <= 200 and outline["x"][0] == outline["x"][-1] == 0.0
    assert outline["x"].max() == 2999.0 and {30.0, -30.0} <= set(outline["y"].tolist())
    assert len(curve["y"]) <= 100 and len(points["x"]) == 100 * CLOUD_FACTOR
    np.testing.assert_array_equal(points["marker"]["color"], points["x"])
    # a band stops at undetermined frames
    traces = band(np.arange(5.0), np.zeros(5), np.array([1.0, 1.0, np.inf, np.inf, 2.0]), "#112233")
    assert [len(trace["x"]) for trace in traces] == [4, 2] and max(traces[1]["y"]) == 2.0
    assert band(np.arange(2.0), np.zeros(2), np.full(2, np.inf), "#112233") == []
    x, random = np.arange(20_000.0), np.random.default_rng(5)
    figures = [
        Figure(str(k), "", "", [line(x, random.standard_normal(len(x)), "line", "#112233")], layout())
        for k in range(12)
    ]
    assert figures_within(figures[:1], figure_text) == figures[:1], "few points stay as they are"
    thinned = figures_within(figures, figure_text)
    assert sum(len(figure_text(each)) for each in thinned) <= FIGURE_BYTES
    for before, after in zip(figures, thinned, strict=True):
        assert all(f(after.data[0]["y"]) == f(before.data[0]["y"]) for f in (np.max, np.min))


def test_views_look_from_the_camera_and_each_stop_shows_the_nearest_picture(
    content: StoredRun, example: Any
) -> None:
    views = camera_views(content)
    assert views is not None
    eye, up = views
    # The camera is at rest at the origin of N: there, it looks along z, and y points down.
    R_NG = example.estimate.X_NG[:, :3, :3]
    upright_N = np.tile([0.0, -1.0, 0.0], (24, 1))
    np.testing.assert_allclose(np.einsum("fij,fj->fi", R_NG, up), upright_N, atol=1e-12)
    towards_N = -example.estimate.r_N / np.linalg.norm(example.estimate.r_N, axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("fij,fj->fi", R_NG, eye), towards_N, atol=1e-9)
    moved = timeline(content, film_frames(StoredFilm(gif(3), (0, 10, 23)), 10**9))
    assert moved is not None and moved["picture"] == [0] * 6 + [1] * 11 + [2] * 7
    assert moved["time"][1] == 0.5 and len(moved["rate"]) == moved["frames"] == 24
    assert "picture" not in (timeline(content, []) or {"picture": 0})


def test_texts_and_arrays_survive_the_page() -> None:
    assert inflated(deflated("σ </script> & more")) == "σ </script> & more"
    text = 'a"b</style>, run x'
    escaped = css_text(text)
    assert "<" not in escaped and '"' not in escaped
    # as a browser reads it: one space after an escape belongs to it
    assert re.sub(r"\\([0-9a-f]{6}) ?", lambda match: chr(int(match[1], 16)), escaped) == text
    np.testing.assert_array_equal(unpacked(packed([1.0, np.inf, 2.5])), [1.0, np.nan, 2.5])
    assert packed(np.zeros((2, 3)))["shape"] == "2, 3"


def test_a_scene_is_seen_whole_however_long_it_is() -> None:
    for lengths in ((1.0, 1.0, 1.0), (30.0, 1.0, 0.4), (5.0, 5.0, 0.005)):
        corners = np.array(list(product((-0.5, 0.5), repeat=3))) * lengths
        for eye in np.random.default_rng(3).normal(size=(5, 3)):
            traces = [points3d(corners, "body"), points3d(9.0 * corners, "cameras", visible="legendonly")]
            away = np.array(list(scene_layout(traces, "mm", eye=eye)["scene"]["camera"]["eye"].values()))
            # plotly makes the product of the sides 1, and shows 45 degrees
            ray = corners / np.cbrt(np.prod(lengths)) - away
            cosine = ray @ -away / np.linalg.norm(ray, axis=1) / np.linalg.norm(away)
            assert np.rad2deg(np.arccos(cosine)).max() < 22.5
