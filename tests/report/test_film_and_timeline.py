"""What the slider of the page moves: frames of the film, views of the body; and the explanations of terms."""

import base64
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.report.page import camera_views, timeline
from polhode.report.page_pictures import film_frames
from polhode.report.plot_style import panels, stack_panels
from polhode.report.template import css_text, deflated, inflated
from polhode.report.terms import TERMS, find_terms
from polhode.run_directory.film import StoredFilm, read_film
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from tests.pipeline.stored_run import stored


def gif(count: int) -> bytes:
    """Noise, which compresses badly."""
    random = np.random.default_rng(1)
    noise = random.integers(0, 256, (count, 303, 732), dtype=np.uint8)
    pictures = [Image.fromarray(each).convert("P") for each in noise]
    stream = io.BytesIO()
    pictures[0].save(stream, "GIF", save_all=True, append_images=pictures[1:])
    return stream.getvalue()


def test_frames_of_the_film_are_those_of_the_table(caplog: pytest.LogCaptureFixture) -> None:
    # The table has twice as many rows: the GIF shows every second frame.
    frames = film_frames(StoredFilm(gif(3), (10, 11, 12, 13, 14)), 10**9)
    assert [each.frame for each in frames] == [10, 12, 14]
    with Image.open(io.BytesIO(base64.b64decode(frames[0].uri.partition(",")[2]))) as picture:
        assert picture.format == "WEBP" and picture.size == (732, 240)
    assert film_frames(StoredFilm(gif(3), (10, 11))) == [] and "3 pictures" in caplog.text
    assert film_frames(StoredFilm(b"GIF89a, cut off", (1, 2))) == [] and film_frames(None) == []


def test_a_damaged_film_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert read_film(tmp_path) is None and caplog.text == ""
    (tmp_path / "model.gif").write_bytes(gif(1))
    (tmp_path / "model.csv").write_text("frame,sunlit\n7,1\n")
    stored = read_film(tmp_path)
    assert stored is not None and stored.frames == (7,) and stored.sunlit
    (tmp_path / "model.csv").write_text("frame\nseven\n")
    assert read_film(tmp_path) is None and "is damaged and is left out" in caplog.text


@pytest.fixture(scope="module")
def content(example: Any, tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    folder = stored(tmp_path_factory.mktemp("timeline") / "run", example)
    return read_stored_run(folder, "run")


def test_views_look_from_the_camera_with_the_image_upright(content: StoredRun, example: Any) -> None:
    views = camera_views(content)
    assert views is not None
    eye, up = views
    # The camera is at rest at the origin of N: there, it looks along z, and y points down.
    R_NG = example.estimate.X_NG[:, :3, :3]
    upright_N = np.tile([0.0, -1.0, 0.0], (24, 1))
    np.testing.assert_allclose(np.einsum("fij,fj->fi", R_NG, up), upright_N, atol=1e-12)
    towards_N = -example.estimate.r_N / np.linalg.norm(example.estimate.r_N, axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("fij,fj->fi", R_NG, eye), towards_N, atol=1e-9)


def test_each_stop_shows_the_nearest_picture(content: StoredRun) -> None:
    film = film_frames(StoredFilm(gif(3), (0, 10, 23)), 10**9)
    line = timeline(content, film)
    assert line is not None
    assert line["picture"] == [0] * 6 + [1] * 11 + [2] * 7
    assert line["time"][1] == 0.5 and len(line["rate"]) == line["frames"] == 24
    assert "picture" not in (timeline(content, []) or {"picture": 0})


def test_terms_are_explained_where_they_occur_and_only_there() -> None:
    names = [each.name for each in find_terms("mesh: chamfer [mm] | RMSE position | k1 = ln(Jxx / Jyy)")]
    assert names == ["k1", "Jxx, Jyy, Jzz", "RMSE", "chamfer"]
    assert [each.name for each in find_terms("position in N | velocity in N")] == ["N"]
    assert find_terms("known force [N m], frames, landmarks; GPS, PNG") == []
    assert len({each.name for each in TERMS}) == len(TERMS)


def test_panels_stand_one_below_the_other_on_a_phone() -> None:
    wide = panels([("a", "b"), ("c", "d")], "time", ("left", "right"))
    narrow = stack_panels(wide)
    tops = [narrow[name]["domain"][1] for name in ("yaxis", "yaxis3", "yaxis2", "yaxis4")]
    assert tops == sorted(tops, reverse=True), "column by column"
    assert all(narrow[name]["domain"] == [0, 1] for name in ("xaxis", "xaxis2", "xaxis3", "xaxis4"))
    assert [each["y"] for each in narrow["annotations"]] == pytest.approx([tops[0], tops[2]])
    assert stack_panels(panels([("a",), ("b",)], "time")) == {}


def test_texts_survive_the_page() -> None:
    assert inflated(deflated("σ </script> & more")) == "σ </script> & more"
    text = 'a"b</style>, run x'
    escaped = css_text(text)
    assert "<" not in escaped and '"' not in escaped
    # as a browser reads it: one space after an escape belongs to it
    assert re.sub(r"\\([0-9a-f]{6}) ?", lambda match: chr(int(match[1], 16)), escaped) == text
