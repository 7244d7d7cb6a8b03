"""polhode plan through the real command line: its files, what it leaves out, its errors."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread

from polhode.cli.main import main
from polhode.files.output.marked_folder import MARK
from polhode.planning.approach.corridor import POSES
from polhode.planning.observability.assess import read_poses
from polhode.planning.plan import final_estimate
from polhode.planning.plan_files import CORRIDOR_COLUMNS, is_in_N
from polhode.run_directory.summary_schema import Intervals
from tests.pipeline.conftest import Example
from tests.pipeline.stored_run import stored

pytestmark = pytest.mark.usefixtures("coarse_keep_out")

Capture = pytest.CaptureFixture[str]
ORIGIN = ["--dock-point", "0", "0", "0", "--dock-axis"]
DOCK = ["--dock-point", "0.06", "0", "0", "--dock-axis", "1", "0", "0", "--stand-off", "0.3"]
AHEAD = ["--horizon", "2", "--confidence", "0.97", "--members", "100"]


def planned(run: Path, out: Path, capsys: Capture, *words: str) -> tuple[dict[str, Any], str]:
    """planning.json and what is printed, in one line."""
    assert main(["plan", str(run), "-o", str(out), *AHEAD, *words]) == 0
    return json.loads((out / "planning.json").read_text()), " ".join(capsys.readouterr().out.split())


def test_everything_is_written_and_opens_again(
    run: Path, example: Example, tmp_path: Path, capsys: Capture
) -> None:
    found, shown = planned(run, out := tmp_path / "out", capsys, *DOCK)
    assert "Keep-out over 2 s at 97 %" in shown and "Corridor" in shown and shown.endswith(str(out))
    mesh = trimesh.load_mesh(out / "keepout.ply")
    assert mesh.is_watertight and mesh.volume == pytest.approx(found["keepout"]["volume_m3"], rel=1e-3)
    assert found["keepout"]["volume_m3"] > 0.12 * 0.20 * 0.24
    assert isinstance(trimesh.load(out / "keepout.glb"), trimesh.Scene)
    speed = trimesh.load_mesh(out / "surface_speed.ply", process=False)
    columns = speed.metadata["_ply_raw"]["vertex"]["data"]
    assert len(columns) == len(example.surface.mesh.vertices)
    largest = found["surface_speed"]["largest_m_s"]
    assert float(columns["largest_m_s"].max()) == pytest.approx(largest, rel=1e-5)
    rows = (out / "corridor.csv").read_text().splitlines()
    assert rows[0] == ",".join(CORRIDOR_COLUMNS)
    last = np.array(rows[-1].split(","), dtype=float)
    assert last[0] == 2.0 and np.linalg.norm(last[4:7]) == pytest.approx(1.0)
    assert found["corridor"]["delta_v_m_s"] > 0.0 and found["left_out"] == {}
    assert not any("--dock-point" in words or "runs into" in words for words in found["notes"])
    assert found["approach"]["looks_at"] == "docking point"
    assert found["approach"]["distance_m"]["end"] == pytest.approx(0.3)
    picture = imread(out / "keepout.png")
    assert picture.shape[0] > 400 and len(np.unique(picture[..., :3].reshape(-1, 3), axis=0)) > 500
    # the whole body of the last pair is inside
    X_NG = example.estimate.X_NG[-1]
    p_N = np.asarray(example.surface.mesh.vertices) @ X_NG[:3, :3].T + X_NG[:3, 3]
    assert mesh.contains(p_N).all() if trimesh.ray.has_embree else True


@pytest.mark.usefixtures("no_pictures")
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
    found, shown = planned(run, tmp_path / "out", capsys)
    assert (
        "By the hull of the body: k1 from 0.00 to 0.60; k2 from 0.00 to 2.00; centre of mass along" in shown
    )
    assert found["intervals"]["com_shift_P"] == [None, [-0.05, 0.04], None]


def test_without_a_mesh_the_rest_is_given_and_the_reason_said(
    bare: Path, tmp_path: Path, capsys: Capture
) -> None:
    found, shown = planned(bare, out := tmp_path / "out", capsys, *DOCK)
    assert "Left out: keepout:" in shown
    assert found["keepout"] is None and "no mesh" in found["left_out"]["keepout"]
    files = {file.name for file in out.iterdir() if file.name != MARK}
    assert files == {"corridor.csv", "plan.txt", "planning.json"}


@pytest.mark.usefixtures("no_pictures")
def test_observability_reads_the_approach(
    run: Path, example: Example, tmp_path: Path, capsys: Capture
) -> None:
    found, shown = planned(run, out := tmp_path / "out", capsys)
    assert "Approach (plan.txt, frame N): from" in shown
    time_s, X_NR = read_poses(out / "plan.txt")
    assert (time_s[0], time_s[-1], len(time_s)) == (0.0, 2.0, POSES)
    np.testing.assert_allclose(X_NR[0, :3, 3], example.tracks.X_NR[-1, :3, 3], atol=1e-9)
    # the file says in which frame its poses are
    assert is_in_N(out / "plan.txt")
    assert main(["observability", str(run), "-o", str(out), "--trajectory", str(out / "plan.txt")]) == 0
    assert f"Metric of {POSES} poses" in capsys.readouterr().out
    table = np.genfromtxt(out / "observability.csv", delimiter=",", names=True, usecols=(0, 1))
    ends = found["approach"]["distance_m"]
    assert table["range_m"][[0, -1]] == pytest.approx([ends["start"], ends["end"]], rel=1e-5)
    assert not is_in_N(tmp_path / "missing.txt") and (out / "planning.json").is_file()


@pytest.mark.usefixtures("no_pictures")
def test_a_docking_point_off_the_target_is_told_of(
    run: Path, bare: Path, tmp_path: Path, capsys: Capture
) -> None:
    dock = ["--dock-point", "0.3", "0", "0", "--dock-axis", "-1", "0", "0"]
    for source in (run, bare):
        found, shown = planned(source, tmp_path / "out", capsys, *dock)
        for words in (shown, " ".join(found["notes"])):
            assert "--dock-point 0.3 0 0 is 0." in words and "off the target" in words
            # towards the target
            assert ("runs into the target" in words) == (source == run)
    _, shown = planned(run, tmp_path / "out", capsys, *ORIGIN, "1", "0", "0")
    assert "--dock-point 0 0 0 is inside the body, 0.06 m below its surface" in shown
    assert "off the target" not in shown
    # far in any unit: refused, and before any work
    dock[1] = "100"
    assert main(["plan", str(bare), "-o", str(tmp_path / "none"), *AHEAD, *dock]) == 2
    assert "give metres in G" in capsys.readouterr().err and not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--horizon", "0"], "--horizon"),
        (["--confidence", "1.5"], "--confidence"),
        (["--members", "10"], "--members"),
        (["--members", "1000000000000"], "--members 1000000000000: give a whole number from 60 to 100000"),
        (["--horizon", "1e308"], "--horizon 1e+308"),
        (["--confidence", "nan"], "--confidence nan"),
        (["--dock-point", "0", "0", "1e308", "--dock-axis", "1", "0", "0"], "--dock-point 0 0 1e308: give 3"),
        ([*ORIGIN, "1e308", "0", "0"], "--dock-axis: give a direction"),
        ([*DOCK, "--stand-off", "1e308"], "--stand-off 1e308: give a number"),
        ([*DOCK, "--isp-s", "1e-308"], "--isp-s 1e-308"),
        (ORIGIN[:4], "--dock-axis"),
        ([*ORIGIN, "0", "0", "0"], "--dock-axis"),
        (["--dock-point", "60", *DOCK[2:]], "--dock-point 60 0 0 is 59.9 m from"),
    ],
)
def test_wrong_words_are_one_line(
    run: Path, tmp_path: Path, capsys: Capture, words: list[str], named: str
) -> None:
    assert main(["plan", str(run), "-o", str(tmp_path / "out"), *words]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and named in captured.err
    assert not (tmp_path / "out").exists()
