"""polhode plan through the real command line: its files, what it leaves out, its errors."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread

from polhode.cli.main import main
from polhode.files.output.marked_folder import MARK
from polhode.planning.approach.approach_path import POSES
from polhode.planning.observability.assess import read_poses
from polhode.planning.plan import final_estimate
from polhode.planning.plan_files import CORRIDOR_COLUMNS, is_in_N
from polhode.planning.prediction import nominal_motion
from polhode.run_directory.summary_schema import Intervals
from tests.pipeline.conftest import Example
from tests.pipeline.stored_run import stored

pytestmark = pytest.mark.usefixtures("coarse_keep_out")

Capture = pytest.CaptureFixture[str]
DOCK = ["--dock-point", "0.06", "0", "0", "--dock-axis", "1", "0", "0", "--stand-off", "0.3"]
AHEAD = ["--horizon", "2", "--confidence", "0.97", "--members", "100"]


def test_everything_is_written_and_opens_again(example: Example, tmp_path: Path, capsys: Capture) -> None:
    run, out = stored(tmp_path / "run", example, example.surface), tmp_path / "out"
    assert main(["plan", str(run), "-o", str(out), *AHEAD, *DOCK]) == 0
    shown = capsys.readouterr().out
    assert "Keep-out over 2 s at 97.0%" in shown and "Corridor" in shown and shown.rstrip().endswith(str(out))
    found = json.loads((out / "planning.json").read_text())
    mesh = trimesh.load_mesh(out / "keepout.ply")
    assert mesh.is_watertight and mesh.volume == pytest.approx(found["keepout"]["volume_m3"], rel=1e-3)
    assert found["keepout"]["volume_m3"] > 0.12 * 0.20 * 0.24
    assert isinstance(trimesh.load(out / "keepout.glb"), trimesh.Scene)
    speed = trimesh.load_mesh(out / "surface_speed.ply", process=False)
    columns = speed.metadata["_ply_raw"]["vertex"]["data"]
    assert len(columns) == len(example.surface.mesh.vertices)
    assert float(columns["largest_m_s"].max()) == pytest.approx(
        found["surface_speed"]["largest_m_s"], rel=1e-5
    )
    rows = (out / "corridor.csv").read_text().splitlines()
    assert rows[0] == ",".join(CORRIDOR_COLUMNS)
    last = np.array(rows[-1].split(","), dtype=float)
    assert last[0] == 2.0 and np.linalg.norm(last[4:7]) == pytest.approx(1.0)
    assert found["corridor"]["delta_v_m_s"] > 0.0 and found["left_out"] == {}
    assert not any("--dock-point" in words or "runs into" in words for words in found["notes"])
    assert found["approach"]["looks_at"] == "docking point"
    assert found["approach"]["distance_m"]["end"] == pytest.approx(0.3)
    for name in ("keepout.png", "surface_speed.png", "corridor.png"):
        picture = imread(out / name)
        assert picture.shape[0] > 400 and len(np.unique(picture[..., :3].reshape(-1, 3), axis=0)) > 500
    # the whole body of the last pair is inside
    estimate = example.estimate
    p_N = np.asarray(example.surface.mesh.vertices) @ estimate.X_NG[-1, :3, :3].T + estimate.X_NG[-1, :3, 3]
    assert mesh.contains(p_N).all() if trimesh.ray.has_embree else True


def test_intervals_are_said_and_bound_the_members(
    undetermined: Example, tmp_path: Path, capsys: Capture
) -> None:
    com_G = undetermined.estimate.mass.com_G
    intervals = Intervals(
        com_G=(tuple(com_G - 0.05), tuple(com_G + 0.05)), com_shift_P=(None, (-0.05, 0.04), None),
        k1=(0.0, 0.6), k2=(0.0, 2.0), bounds=("inside the hull",),
    )  # fmt: skip
    run = stored(tmp_path / "run", undetermined, undetermined.surface, intervals=intervals)
    estimate, _ = final_estimate(run)
    assert estimate.com_range_G is not None
    np.testing.assert_allclose(estimate.com_range_G[0], com_G - 0.05)
    assert main(["plan", str(run), "-o", str(tmp_path / "out"), *AHEAD]) == 0
    words = "By the hull of the body: k1 from 0.00 to 0.60; k2 from 0.00 to 2.00; centre of mass along"
    assert words in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "planning.json").read_text())
    assert found["intervals"]["com_shift_P"] == [None, [-0.05, 0.04], None]


def test_without_a_mesh_the_rest_is_given_and_the_reason_said(
    example: Example, tmp_path: Path, capsys: Capture
) -> None:
    run, out = stored(tmp_path / "run", example), tmp_path / "out"
    assert main(["plan", str(run), "-o", str(out), *AHEAD, *DOCK]) == 0
    assert "Left out: keepout:" in capsys.readouterr().out
    found = json.loads((out / "planning.json").read_text())
    assert found["keepout"] is None and "no mesh" in found["left_out"]["keepout"]
    assert sorted(file.name for file in out.iterdir() if file.name != MARK) == [
        "corridor.csv",
        "corridor.png",
        "plan.txt",
        "planning.json",
    ]


def test_observability_reads_the_approach(
    example: Example, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("polhode.planning.plan_files.plan_pictures", lambda *_: {})
    for name in ("draw_metric", "draw_views", "draw_contributions"):
        monkeypatch.setattr(f"polhode.planning.observability.pictures.{name}", lambda *_: b"png")
    run, out = stored(tmp_path / "run", example, example.surface), tmp_path / "out"
    assert main(["plan", str(run), "-o", str(out), *AHEAD]) == 0
    assert "Approach (plan.txt, frame N): from" in capsys.readouterr().out
    poses = read_poses(out / "plan.txt")
    assert (poses.time_s[0], poses.time_s[-1], len(poses.time_s)) == (0.0, 2.0, POSES)
    np.testing.assert_allclose(poses.X_FR[0, :3, 3], example.tracks.X_NR[-1, :3, 3], atol=1e-9)
    words = ["--trajectory", str(out / "plan.txt"), "--frame", "inertial"]
    assert main(["observability", str(run), "-o", str(out), *words]) == 0
    assert f"Metric of {POSES} poses" in capsys.readouterr().out
    table = (out / "observability.csv").read_bytes()
    # the file says in which frame its poses are
    assert main(["observability", str(run), "-o", str(out), *words[:2]]) == 0
    assert (out / "observability.csv").read_bytes() == table
    assert not is_in_N(tmp_path / "missing.txt")
    assert (out / "observability.json").is_file() and (out / "planning.json").is_file()


@pytest.mark.parametrize("mesh", [True, False])
def test_a_docking_point_off_the_target_is_told_of(
    mesh: bool, example: Example, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # drawing takes most of the time
    monkeypatch.setattr("polhode.planning.plan_files.plan_pictures", lambda *_: {})
    run = stored(tmp_path / "run", example, example.surface if mesh else None)
    dock = ["--dock-point", "0.3", "0", "0", "--dock-axis", "-1", "0", "0"]
    assert main(["plan", str(run), "-o", str(tmp_path / "out"), *AHEAD, *dock]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    notes = " ".join(json.loads((tmp_path / "out" / "planning.json").read_text())["notes"])
    for words in (shown, notes):
        assert "--dock-point 0.3 0 0 is 0." in words and "off the target" in words
        # towards the target
        assert ("runs into the target" in words) == mesh
    inside = ["--dock-point", "0", "0", "0", "--dock-axis", "1", "0", "0"]
    if mesh:
        assert main(["plan", str(run), "-o", str(tmp_path / "out"), *AHEAD, *inside]) == 0
        shown = " ".join(capsys.readouterr().out.split())
        assert "--dock-point 0 0 0 is inside the body, 0.06 m below its surface" in shown
        assert "off the target" not in shown
    # far in any unit: refused, and before any work
    dock[1] = "100"
    assert main(["plan", str(run), "-o", str(tmp_path / "none"), *AHEAD, *dock]) == 2
    assert "give metres in G" in capsys.readouterr().err and not (tmp_path / "none").exists()


@pytest.mark.parametrize("half_angle_deg", [5.0, 89.0])
def test_the_half_angle_decides_when_the_resting_camera_is_in_the_cone(
    half_angle_deg: float,
    example: Example,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("polhode.planning.plan_files.plan_pictures", lambda *_: {})
    run, out = stored(tmp_path / "run", example), tmp_path / "out"
    # towards the camera when half of the horizon has passed
    estimate, _ = final_estimate(run)
    motion = nominal_motion(estimate, np.array([1.0]))
    point_G = np.array([0.06, 0.0, 0.0])
    camera_N = example.tracks.X_NR[-1, :3, 3]
    axis_G = motion.R_NG[0].T @ (camera_N - motion.p_NG[0]) - point_G
    dock = ["--dock-point", "0.06", "0", "0", "--dock-axis", *(f"{x:.12g}" for x in axis_G)]
    words = [*AHEAD, *dock, "--half-angle-deg", f"{half_angle_deg:g}"]
    assert main(["plan", str(run), "-o", str(out), *words]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    table = np.genfromtxt(out / "corridor.csv", delimiter=",", names=True)
    offset = camera_N - np.stack([table[f"tip_N_{a}"] for a in "xyz"], axis=1)
    axis = np.stack([table[f"axis_N_{a}"] for a in "xyz"], axis=1)
    chord = np.linalg.norm(offset / np.linalg.norm(offset, axis=1, keepdims=True) - axis, axis=1)
    angle_deg = np.rad2deg(2.0 * np.arcsin(0.5 * chord))
    np.testing.assert_allclose(table["camera_angle_deg"], angle_deg, atol=1e-4)
    inside = table["camera_in_cone"] == 1.0
    np.testing.assert_array_equal(inside, table["camera_angle_deg"] <= half_angle_deg)
    assert inside.any()
    found = json.loads((out / "planning.json").read_text())["corridor"]["resting_camera"]
    assert found["least_angle_at_s"] == pytest.approx(1.0, abs=0.1)
    ((first, last),) = found["in_cone_s"]
    assert (first, last) == pytest.approx(tuple(table["time_s"][inside][[0, -1]]))
    assert f"is in the cone of {half_angle_deg:g} deg from {first:.1f} to {last:.1f} s" in shown
    assert "over 2 s" in shown and "of the mass at an Isp of 230 s" in shown


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--horizon", "0"], "--horizon"),
        (["--confidence", "1.5"], "--confidence"),
        (["--members", "10"], "--members"),
        (["--members", "-1"], "--members -1"),
        (["--members", "1000000000000"], "--members 1000000000000: give a whole number from 1 to 100000"),
        (["--horizon", "inf"], "--horizon inf"),
        (["--horizon", "1e308"], "--horizon 1e+308"),
        (["--horizon", "1e-308"], "--horizon 1e-308"),
        (["--confidence", "nan"], "--confidence nan"),
        (["--dock-point", "0", "0", "1e308", "--dock-axis", "1", "0", "0"], "--dock-point 0 0 1e308: give 3"),
        (["--dock-point", "0", "0", "nan", "--dock-axis", "1", "0", "0"], "--dock-point 0 0 nan: give 3"),
        (["--dock-point", "0", "0", "0", "--dock-axis", "1e308", "0", "0"], "--dock-axis: give a direction"),
        (["--dock-point", "0", "0", "0", "--dock-axis", "nan", "0", "0"], "--dock-axis: give a direction"),
        ([*DOCK, "--stand-off", "1e308"], "--stand-off 1e308: give a number"),
        ([*DOCK, "--half-angle-deg", "180"], "--half-angle-deg 180"),
        ([*DOCK, "--isp-s", "1e-308"], "--isp-s 1e-308"),
        (["--dock-point", "0", "0", "0"], "--dock-axis"),
        (["--dock-point", "0", "0", "0", "--dock-axis", "0", "0", "0"], "--dock-axis"),
        (
            ["--dock-point", "60", "0", "0", "--dock-axis", "1", "0", "0"],
            "--dock-point 60 0 0 is 59.9 m from",
        ),
    ],
)
def test_wrong_words_are_one_line(
    example: Example, tmp_path: Path, capsys: Capture, words: list[str], named: str
) -> None:
    run = stored(tmp_path / "run", example, example.surface)
    assert main(["plan", str(run), "-o", str(tmp_path / "out"), *words]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and named in captured.err
    assert not (tmp_path / "out").exists()
