"""polhode observability through the real command line: its files, degenerate bodies, its errors."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from polhode.cli.main import main
from polhode.config import Config
from polhode.files.output.marked_folder import MARK
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.planning.exports.ccsds import tum
from polhode.records.surface import SurfaceModel
from tests.pipeline.conftest import Example
from tests.pipeline.stored_run import write_run

Capture = pytest.CaptureFixture[str]
FILES = {
    "observability.json",
    "observability.csv",
    "edges.csv",
    "metric.png",
    "views.png",
    "contributions.png",
    "edges.ply",
    "edges.glb",
}


def trajectory(path: Path, X_FR: Array) -> Path:
    path.write_text(tum(10**9 * np.arange(len(X_FR)), X_FR, []))
    return path


def approach(count: int = 5, far: float = 4.0, near: float = 2.0) -> Array:
    """Camera places in G on the way to a body at its origin, the body seen askew."""
    z = np.linspace(far, near, count)
    return inverse_pose(make_pose(np.tile(exp_so3([0.5, 0.4, 0.1]), (count, 1, 1)), np.outer(z, [0, 0, 1.0])))


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers alone: drawing takes most of the time."""
    for name in ("draw_metric", "draw_views", "draw_contributions"):
        monkeypatch.setattr(f"polhode.planning.observability.pictures.{name}", lambda *_: b"")


@pytest.fixture
def box(tmp_path: Path) -> Path:
    path = tmp_path / "box.stl"
    trimesh.creation.box((1.0, 0.6, 0.4)).export(path)
    return path


def written(example: Example, folder: Path, surface: SurfaceModel | None) -> Path:
    folder.mkdir()
    write_run(
        folder,
        config=Config(),
        tracks=example.tracks,
        estimate=example.estimate,
        surface=surface,
        timing_s={},
    )
    return folder


def test_a_mesh_along_an_approach(box: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    poses = trajectory(tmp_path / "poses.txt", approach())
    assert main(["observability", str(box), "--trajectory", str(poses), "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "12 straight edges" in shown and "about z" in shown and shown.rstrip().endswith(str(out))
    assert {path.name for path in out.iterdir()} == FILES | {MARK}
    found = json.loads((out / "observability.json").read_text())
    assert found["along"]["poses_that_tell_all"] == 5
    assert [pose["range_m"] for pose in found["poses"]] == pytest.approx([4.0, 3.5, 3.0, 2.5, 2.0])
    for pose in found["poses"]:
        C, covariance = np.array(pose["C"]), np.array(pose["covariance"])
        assert np.allclose(C @ covariance, np.eye(6), atol=1e-8)
        assert np.allclose(np.sqrt(np.diagonal(covariance)), pose["sigma"])
    depth = [pose["sigma"][2] for pose in found["poses"]]
    assert (np.diff(depth) < 0.0).all()
    with (out / "observability.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["sigma_z_m"]) for row in rows] == pytest.approx(depth, rel=1e-5)
    with (out / "edges.csv").open() as file:
        edges = list(csv.DictReader(file))
    assert len(edges) == 12
    assert sum(float(edge["share_about_x"]) for edge in edges) == pytest.approx(1.0, abs=1e-4)
    assert len(trimesh.load_mesh(out / "edges.ply").faces) > 12
    assert isinstance(trimesh.load(out / "edges.glb"), trimesh.Scene)


@pytest.mark.usefixtures("no_pictures")
def test_noise_point_and_unit_scale_as_they_should(box: Path, tmp_path: Path) -> None:
    poses = trajectory(tmp_path / "poses.txt", approach(1, 3.0))

    out = tmp_path / "out"
    word = ["observability", str(box), "--trajectory", str(poses), "-o", str(out)]

    def sigma(*options: str) -> Array:
        assert main([*word, *options]) == 0
        return np.array(json.loads((out / "observability.json").read_text())["poses"][0]["sigma"])

    plain = sigma()
    assert sigma("--sigma-px", "0.3") == pytest.approx(0.3 * plain)
    # About another point turns are as well known, shifts are not.
    aside = sigma("--about", "1", "0", "0")
    assert aside[3:] == pytest.approx(plain[3:]) and (aside[:3] > plain[:3]).any()
    # An edge every five pixels instead of ten is twice the information.
    assert sigma("--spacing-px", "5") == pytest.approx(plain / np.sqrt(2), rel=0.1)
    millimetres = trimesh.creation.box((1000.0, 600.0, 400.0))
    millimetres.export(box)
    assert sigma("--unit", "mm") == pytest.approx(plain, rel=1e-4)


def test_the_best_few_edges_and_the_fewest_that_do(box: Path, tmp_path: Path, capsys: Capture) -> None:
    poses, out = trajectory(tmp_path / "poses.txt", approach(3)), tmp_path / "out"
    word = ["observability", str(box), "--trajectory", str(poses), "-o", str(out)]
    assert main([*word, "--edges", "5", "--fewest"]) == 0
    shown = capsys.readouterr().out
    assert "edges suffice" in shown and "The best 5 edges" in shown
    found = json.loads((out / "observability.json").read_text())["choice"]
    smallest, best = found["smallest_set"], found["best"]
    assert max(smallest["ratio"]) <= 1.1 and smallest["at_least"] <= len(smallest["edges"]) <= 9
    assert len(best["edges"]) == 5 and min(best["ratio"]) >= 1.0 and best["value"] <= best["bound"]
    with (out / "edges.csv").open() as file:
        rows = list(csv.DictReader(file))
    for name, edges in ("in_smallest_set", smallest["edges"]), ("in_best", best["edges"]):
        assert [int(row["edge"]) for row in rows if row[name] == "1"] == sorted(edges)
    assert main([*word, "--edges", "0"]) == 2
    assert "--edges 0" in capsys.readouterr().err


@pytest.mark.usefixtures("no_pictures")
def test_sunlight_takes_edges_away(box: Path, tmp_path: Path, capsys: Capture) -> None:
    poses = trajectory(tmp_path / "poses.txt", approach(1, 3.0))
    word = ["observability", str(box), "--trajectory", str(poses), "-o", str(tmp_path / "out")]
    assert main(word) == 0
    all_ = json.loads((tmp_path / "out" / "observability.json").read_text())
    to_camera = approach(1, 3.0)[0, :3, 3]
    assert main([*word, "--sun", *(f"{value:.6f}" for value in to_camera)]) == 0
    behind_camera = json.loads((tmp_path / "out" / "observability.json").read_text())
    assert main([*word, "--sun", *(f"{-value:.6f}" for value in to_camera)]) == 0
    dark = json.loads((tmp_path / "out" / "observability.json").read_text())
    assert behind_camera["sunlit"] and not all_["sunlit"]
    assert dark["poses"][0]["points"] < behind_camera["poses"][0]["points"] <= all_["poses"][0]["points"]
    capsys.readouterr()


@pytest.mark.parametrize(
    ("mesh", "places", "words"),
    [
        (trimesh.creation.icosphere(3, 0.5), approach(2), "rotation about"),
        (trimesh.creation.box((1.0, 0.6, 0.4)), approach(2, -4.0, -2.0), "no edge is visible"),
        (trimesh.creation.cylinder(0.4, 0.8, sections=64), approach(2), "is unobservable"),
    ],
    ids=["sphere", "behind the camera", "cylinder"],
)
def test_what_is_not_told_is_infinite_and_said(
    mesh: trimesh.Trimesh, places: Array, words: str, tmp_path: Path, capsys: Capture
) -> None:
    file, out = tmp_path / "body.ply", tmp_path / "out"
    mesh.export(file)
    poses = trajectory(tmp_path / "poses.txt", places)
    assert main(["observability", str(file), "--trajectory", str(poses), "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert words in shown and "inf" in shown and "undetermined at every pose" in shown
    found = json.loads((out / "observability.json").read_text())
    assert None in found["poses"][0]["sigma"] and words in found["poses"][0]["not_told"]
    assert "inf" in (out / "observability.csv").read_text()


@pytest.mark.usefixtures("no_pictures")
def test_a_run_by_its_own_places_and_by_planned_ones(
    example: Example, tmp_path: Path, capsys: Capture
) -> None:
    run, out = written(example, tmp_path / "run", example.surface), tmp_path / "out"
    assert main(["observability", str(run), "-o", str(out), "--crease-deg", "5"]) == 2
    assert "--crease-deg is for a mesh" in capsys.readouterr().err
    assert main(["observability", str(run), "-o", str(out)]) == 0
    found = json.loads((out / "observability.json").read_text())
    assert len(found["poses"]) == len(example.tracks.timestamps_ns)
    assert found["about"]["o_G"] == pytest.approx(example.estimate.mass.com_G.tolist())
    assert found["camera"]["focal_px"] == example.tracks.rig.focal_px
    # At the last pair the prediction is the estimate: the camera of that pair, in N.
    last = trajectory(tmp_path / "last.txt", example.tracks.X_NR[-1:])
    assert main(["observability", str(run), "--trajectory", str(last), "--frame", "N", "-o", str(out)]) == 0
    forecast = json.loads((out / "observability.json").read_text())["poses"]
    assert forecast[0]["sigma"] == pytest.approx(found["poses"][-1]["sigma"], rel=1e-6)
    assert "measured" in capsys.readouterr().out


def test_a_run_without_a_mesh_says_so(example: Example, tmp_path: Path, capsys: Capture) -> None:
    run = written(example, tmp_path / "run", None)
    assert main(["observability", str(run), "-o", str(tmp_path / "out")]) == 2
    assert "has no mesh" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "contains no pose"),
        ("0 0 0 4 0 0 0\n", "8 finite numbers"),
        ("nan 0 0 4 0 0 0 1\n", "8 finite numbers"),
        ("0 0 0 4 0 0 0 1_0\n", "8 finite numbers"),
        ("0 " * 5000, "longer than 4096 characters"),
        ("0 0 0 4 0 0 0 x\n", "line 1"),
        ("# t\n0 0 0 4 0 0 0 nan\n", "line 2"),
        ("0 0 0 4 0 0 0 2\n", "length 2"),
        ("\ufeff0 0 0 4 0 0 0 2\n", "length 2"),
        ("0 1e200 0 4 0 0 0 1\n", "above 1e+12"),
        ("0 0 0 4 0 0 1e200 1e200\n", "above 1e+12"),
        ("1 0 0 4 0 0 0 1\n1 0 0 4 0 0 0 1\n", "not later"),
    ],
)
def test_wrong_trajectories(content: str, words: str, box: Path, tmp_path: Path, capsys: Capture) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text(content)
    assert main(["observability", str(box), "--trajectory", str(poses), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--sigma-px", "0"], "--sigma-px"),
        (["--spacing-px", "-1"], "--spacing-px"),
        (["--crease-deg", "180"], "--crease-deg"),
        (["--sun", "0", "0", "0"], "--sun"),
        (["--sun", "1e200", "1e200", "0"], "--sun"),
        (["--sigma-px", "1e300"], "--sigma-px"),
        (["--spacing-px", "1e-3"], "--spacing-px"),
        (["--about", "1e300", "0", "0"], "--about"),
        (["--width-px", "9" * 23], "--width-px"),
        (["--edges", "0"], "--edges 0"),
        (["--edges", "9" * 400], "--edges 99999999999999999999: give a number from 1 to"),
        (["--focal-px", "1e308"], "give a number from 1 to 1e+09"),
        (["--focal-px", "nan"], "give a number from 1 to 1e+09"),
        (["--height-px", "1"], "--height-px 1: give a whole number from 16 to 100000"),
        (["--about", "nan", "0", "0"], "--about"),
        (["--focal-px", "0"], "--focal-px"),
        (["--frame", "N"], "--frame inertial is for a run"),
    ],
)
def test_wrong_options(options: list[str], words: str, box: Path, tmp_path: Path, capsys: Capture) -> None:
    poses = trajectory(tmp_path / "poses.txt", approach(1))
    word = ["observability", str(box), "--trajectory", str(poses), "-o", str(tmp_path / "out")]
    assert main([*word, *options]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_wrong_sources(tmp_path: Path, box: Path, capsys: Capture) -> None:
    poses = str(trajectory(tmp_path / "poses.txt", approach(1)))
    out = ["-o", str(tmp_path / "out")]
    for source, words in (
        (tmp_path / "none.stl", "no such run or mesh"),
        (tmp_path / "poses.txt", "cannot be read as a mesh"),
        (tmp_path, "summary.json"),
    ):
        assert main(["observability", str(source), "--trajectory", poses, *out]) == 2
        assert words in capsys.readouterr().err
    assert main(["observability", str(box), *out]) == 2
    assert "--trajectory" in capsys.readouterr().err
    assert main(["observability", str(box), "--trajectory", poses, "-o", str(box)]) == 2
    assert "this is a file" in capsys.readouterr().err
