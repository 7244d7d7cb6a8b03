"""polhode export through the real command line; what it writes is given to the programs it is meant for."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from trimesh.visual import ColorVisuals

import polhode
from polhode.cli.main import main
from polhode.geometry.lie import Array, log_so3, make_pose, matrix_from_wxyz
from polhode.mapping.mesh_files import read_ply, write_ply
from polhode.planning.exports import convex_pieces
from polhode.planning.exports.json_document import SCHEMA_FILE, Document
from polhode.planning.exports.options import FrameName
from polhode.records.occupancy import FREE, OUTLINED, POSSIBLE, Occupancy
from polhode.run_directory.archives import write_occupancy
from polhode.run_directory.summary import build_summary, read_summary, write_summary
from polhode.run_directory.summary_schema import Intervals, json_schema
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import BOX_M, Example
from tests.pipeline.stored_run import stored

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that found nothing."""
    folder = tmp_path_factory.mktemp("failed")
    write_summary(build_summary(None, None, None, {}, failure="no motion fits"), folder / "summary.json")
    return folder


def export(run: Path, to: str, output: Path, *more: str) -> Path:
    assert main(["export", str(run), "--to", to, "-o", str(output), *more]) == 0
    return output


def document(run: Path, folder: Path, *more: str) -> dict[str, Any]:
    content = json.loads(export(run, "json", folder / "run.json", *more).read_text())
    jsonschema.Draft202012Validator(json_schema(Document)).validate(content)
    assert isinstance(content, dict)
    return content


def test_json_has_states_with_covariances_and_mass_properties(
    run: Path, example: Example, tmp_path: Path
) -> None:
    assert json.loads(SCHEMA_FILE.read_text()) == json_schema(Document)
    content = document(run, tmp_path, "--horizon", "5", "--mass-kg", "4.5")
    last, estimate = content["last"], example.estimate
    assert last["timestamp_ns"] == estimate.timestamps_ns[-1] and last["utc"].startswith("1970-01-01T00:00:1")
    np.testing.assert_allclose(last["r_N"], estimate.r_N[-1])
    assert np.shape(last["covariance"]) == (12, 12) and len(content["prediction"]) == 10
    assert content["prediction"][-1]["covariance"][0][0] > last["covariance"][0][0] > 0.0
    # the box has uniform density, so the assumption is right
    x, y, z = BOX_M
    right = 4.5 / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(content["inertial"]["moments_kg_m2"], right, rtol=1e-6)
    assert content["inertial"]["mass_is"] == "given" and content["inertial"]["scale_is"] == "assumed"
    assert content["mass_properties"]["identifiable"]["k1"] and content["left_out"] == []


@pytest.mark.parametrize(("to", "frame"), [("mjcf", "G"), ("urdf", "P")])
def test_mujoco_simulates_what_we_predict(to: str, frame: str, run: Path, tmp_path: Path) -> None:
    options = ("--frame", frame, "--mass-kg", "4.5", "--pieces", "4", "--horizon", "30")
    content = document(run, tmp_path, *options)
    file = export(run, to, tmp_path / f"box.{to}", *options)
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    last = content["last"]
    body = model.body("target").id
    assert model.nq == 7 and model.body_mass[body] == 4.5
    np.testing.assert_allclose(
        np.sort(model.body_inertia[body]), np.sort(content["inertial"]["moments_kg_m2"]), rtol=1e-9
    )
    if to == "mjcf":
        mujoco.mj_resetDataKeyframe(model, data, model.key("last").id)
    else:
        # URDF holds a pose, no rates and no settings
        model.opt.gravity[:], model.opt.timestep = 0.0, 0.002
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        R_NF = matrix_from_wxyz(last["q_NF_wxyz"])
        w_N = matrix_from_wxyz(last["q_NP_wxyz"]) @ last["w_P"]
        lever = np.array(last["p_NF"]) - last["r_N"]
        data.qvel[:3], data.qvel[3:] = last["v_N"] + np.cross(w_N, lever), R_NF.T @ w_N
    worst_deg = worst_m = 0.0
    for row in content["prediction"]:
        while data.time < row["time_s"] - 1e-6:
            mujoco.mj_step(model, data)
        turn = log_so3(matrix_from_wxyz(data.qpos[3:7]).T @ matrix_from_wxyz(row["q_NF_wxyz"]))
        worst_deg = max(worst_deg, float(np.rad2deg(np.linalg.norm(turn))))
        worst_m = max(worst_m, float(np.abs(data.qpos[:3] - row["p_NF"]).max()))
    assert content["prediction"][-1]["time_s"] == pytest.approx(30.0)
    assert worst_deg < 0.1 and worst_m < 1e-4


def test_meshes_open_at_the_right_place_and_scale(run: Path, example: Example, tmp_path: Path) -> None:
    for to in ("ply", "glb", "stl", "obj"):
        for frame, unit, per_m in (("G", "m", 1.0), ("P", "mm", 1000.0)):
            file = export(run, to, tmp_path / f"{frame}.{to}", "--frame", frame, "--unit", unit)
            mesh = trimesh.load_mesh(file)
            assert mesh.volume == pytest.approx(per_m**3 * np.prod(BOX_M), rel=1e-5)
            # P has its origin at the centre of mass, with the axes of G in this example
            middle = 0.0 if frame == "G" else -example.estimate.mass.com_G
            np.testing.assert_allclose(
                mesh.bounds.mean(axis=0), per_m * middle * np.ones(3), atol=1e-4 * per_m
            )
            if to in ("ply", "obj"):
                assert isinstance(mesh.visual, ColorVisuals)
                found = {tuple(c) for c in np.asarray(mesh.visual.vertex_colors)[:, :3].tolist()}
                assert len(found) > 50
    ply = trimesh.load(tmp_path / "P.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(ply["sigma_mm"].reshape(-1), 0.8, rtol=1e-6)


def test_the_pieces_contain_what_is_known_to_be_beside_the_mesh(
    example: Example, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """A boom that outlines show and a corner that no frame excludes: each is covered where asked for."""
    pytest.importorskip("vhacdx")
    monkeypatch.setattr(convex_pieces, "VOXELS", 50_000)
    folder = stored(tmp_path / "boom", example, example.surface)
    corner, step_m = np.full(3, -0.25), 0.01
    centres = np.stack(np.meshgrid(*[corner[0] + step_m * np.arange(51)] * 3, indexing="ij"), -1)
    boom = (np.abs(centres[..., :2]) < 0.006).all(-1) & (centres[..., 2] > 0.12)
    dark = (centres[..., 0] > 0.06) & (centres[..., 0] < 0.1) & (np.abs(centres[..., 1:]) < 0.03).all(-1)
    state = np.where(boom, OUTLINED, np.where(dark, POSSIBLE, FREE)).astype(np.uint8)
    write_occupancy(Occupancy(corner, step_m, state), folder / "occupancy.npz")
    ends = 0.4999 * step_m * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    of_boom, of_dark = ((centres[each][:, None] + ends).reshape(-1, 3) for each in (boom, dark))
    box = np.asarray(example.surface.mesh.vertices)

    def held(cover: str, points: Array) -> float:
        """Share of the points that are inside a piece."""
        meshes = tmp_path / f"{cover}.xml_meshes"
        pieces = [trimesh.load_mesh(file) for file in sorted(meshes.glob("collision_*.obj"))]
        planes = [ConvexHull(np.asarray(piece.vertices)).equations for piece in pieces]
        return float(
            (np.stack([convex_pieces.outside(points, each) for each in planes]).min(0) < 1e-6).mean()
        )

    covered = {"auto": (1, 1), "outlines": (1, 0), "surface": (0, 0), "hull": (1, None)}
    words = {
        "auto": "no frame excludes",
        "outlines": "outlines of",
        "surface": "mesh alone",
        "hull": "hull of",
    }
    for cover, shares in covered.items():
        file = export(folder, "mjcf", tmp_path / f"{cover}.xml", "--pieces", "32", "--cover", cover)
        assert words[cover] in " ".join(file.read_text().split()) and held(cover, box) == 1.0
        for points, share in zip((of_boom, of_dark), shares, strict=True):
            assert share is None or abs(held(cover, points) - share) < 0.1 * (1 - share) + 1e-9, cover
    assert len(list((tmp_path / "auto.xml_meshes").glob("collision_*.obj"))) > 1
    # the same mesh without an occupancy: nothing is covered but the mesh
    export(run, "mjcf", tmp_path / "old.xml", "--pieces", "32")
    old, alone = (
        {
            file.name: file.read_bytes()
            for file in (tmp_path / f"{name}.xml_meshes").iterdir()
            if file.is_file()
        }
        for name in ("old", "surface")
    )
    assert {name for name in old if name.startswith("collision")} <= set(alone)
    assert all(old[name] == alone[name] for name in old if name.startswith("collision"))
    capsys.readouterr()
    assert main(["export", str(run), "--to", "urdf", "-o", str(tmp_path / "x"), "--cover", "possible"]) == 2
    assert "--cover possible: the run has no occupancy.npz" in capsys.readouterr().err
    with pytest.raises(InputError, match="cover='outlines': the run has no occupancy"):
        polhode.load(run).export("urdf", tmp_path / "x", cover="outlines")


def test_a_run_without_a_mesh_exports_what_it_can(bare: Path, tmp_path: Path, capsys: Capture) -> None:
    cloud = trimesh.load(export(bare, "ply", tmp_path / "points.ply"))
    assert isinstance(cloud, trimesh.PointCloud) and len(cloud.vertices) == 150
    assert "no mesh: the file holds the landmarks" in capsys.readouterr().out
    export(bare, "glb", tmp_path / "points.glb")
    file = export(bare, "mjcf", tmp_path / "bare.mjcf", "--mass-kg", "5")
    shown = capsys.readouterr().out
    assert "collision geometry are left out: this run has no mesh" in shown
    assert "relative, the middle moment is 1" in shown and "a mass alone does not set it" in shown
    assert mujoco.MjModel.from_xml_path(str(file)).ngeom == 0
    assert "relative, the middle moment is 1" in file.read_text()
    content = document(bare, tmp_path, "--horizon", "2")
    assert content["shape"] is None and content["inertial"]["scale_is"] == "relative"
    assert any("shape is left out" in words for words in content["left_out"])


def test_an_undetermined_inertia_is_exported_as_such(
    spinning: Path, undetermined: Example, tmp_path: Path, capsys: Capture
) -> None:
    text = export(spinning, "oem", tmp_path / "spin.oem", "--horizon", "2").read_text()
    assert "does not determine" in capsys.readouterr().out
    assert "as a mark on the body" in " ".join(text.split()) and "inf" not in text.split("META_STOP")[1]
    # intervals hold the centre of mass
    run = stored(tmp_path / "spin", undetermined, undetermined.surface)
    intervals = Intervals(com_shift_P=(None, (0.02, 0.05), None), k1=(0.0, 0.6), bounds=("inside the hull",))
    summary = read_summary(run).model_copy(update={"intervals": intervals})
    write_summary(summary, run / "summary.json")
    content = document(run, tmp_path, "--horizon", "2")
    assert content["mass_properties"]["cov_k"] == [[None, None], [None, None]]
    assert content["last"]["covariance"][1][1] is None
    assert content["mass_properties"]["intervals"]["com_shift_P"] == [None, [0.02, 0.05], None]
    moved = np.array(content["inertial"]["com_F"]) - undetermined.estimate.mass.com_G
    np.testing.assert_allclose(moved, 0.02 * undetermined.estimate.mass.R_GP[:, 1], atol=1e-12)
    text = " ".join(export(run, "urdf", tmp_path / "spin.urdf").read_text().split())
    for words in (
        "moved by 20 mm into the body",
        "possible by the hull of the body: k1 from 0.00 to 0.60",
        "not determined by the motion: k1, k2, the principal axes, the centre of mass",
    ):
        assert words in text
    assert main(["predict", str(run), "--horizon", "2"]) == 0
    assert "By the hull of the body: k1 from 0.00 to 0.60" in capsys.readouterr().out


def test_a_failed_run_exports_what_it_found(
    failed: Path, example: Example, tmp_path: Path, capsys: Capture
) -> None:
    content = document(failed, tmp_path)
    assert content["run_status"] == "failed" and content["last"] is None
    assert "no motion fits" in capsys.readouterr().out
    for to in ("ply", "stl", "mjcf", "oem", "aem", "tum"):
        assert main(["export", str(failed), "--to", to, "-o", str(tmp_path / "x")]) == 2
        stderr = capsys.readouterr().err
        assert stderr.count("\n") == 1 and "this run" in stderr
        if to in ("oem", "aem", "tum"):
            # the reason, and no advice about frames
            assert "before it had a motion (no motion fits)" in stderr and "--frame" not in stderr
    assert not (tmp_path / "x").exists()
    # a mesh without a motion: what is assumed is said
    write_ply(example.surface, failed / "mesh.ply")
    text = export(failed, "mjcf", tmp_path / "shape.xml", "--mass-kg", "4.5").read_text()
    shown = capsys.readouterr().out
    assert "assumed, uniform density" in text and "the state is left out" in shown
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "shape.xml")).body_mass[1] == 4.5


@pytest.mark.parametrize("frame", ["P", "G"])
def test_estimated_poses_in_tum_are_those_of_the_run(frame: FrameName, run: Path, tmp_path: Path) -> None:
    file = export(run, "tum", tmp_path / "run.tum", "--poses", "estimated", "--frame", frame)
    rows = [line.split() for line in file.read_text().splitlines() if not line.startswith("#")]
    stored = polhode.load(run)
    stamps = [int(row[0].replace(".", "")) for row in rows]
    assert stamps == stored.trajectory.timestamps_ns.tolist()
    values = np.array(rows)[:, 1:].astype(float)
    X_NF = make_pose(matrix_from_wxyz(values[:, [6, 3, 4, 5]]), values[:, :3])
    expected = stored.X_NG if frame == "G" else make_pose(stored.trajectory.R_NP, stored.trajectory.r_N)
    np.testing.assert_allclose(X_NF, expected, atol=1e-9)
    (same,) = stored.export("tum", tmp_path / "same.tum", poses="estimated", frame=frame)
    assert same.read_bytes() == file.read_bytes()
    with pytest.raises(InputError, match="poses='estimated': only tum"):
        stored.export("aem", tmp_path / "x.aem", poses="estimated")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "obl"], "--to 'obl': unknown; did you mean obj?"),
        (["--to", "urdf", "--mass-kg", "0"], "--mass-kg 0: give a number above 0"),
        (["--to", "json", "--mass-kg", "1e308"], "--mass-kg 1e+308: give a number from 1e-09 to 1e+15"),
        (
            ["--to", "json", "--horizon", "100", "--step-s", "1e-3"],
            "100001 states, each with two covariances",
        ),
        (["--to", "json", "--middle-moment-kg-m2", "1e-308"], "--middle-moment-kg-m2 1e-308"),
        (["--to", "tum", "--horizon", "1e-6", "--step-s", "1e-10"], "timestamps are whole nanoseconds"),
        (
            ["--to", "oem", "-o", "x.stl"],
            "-o x.stl: .stl is the suffix of another format than oem; give x.oem",
        ),
        (
            ["--to", "json", "--mass-kg", "5", "--middle-moment-kg-m2", "1e9"],
            "a radius of gyration of 1.65e+04 m",
        ),
        (["--to", "urdf", "--mass-kg", "5", "--middle-moment-kg-m2", "1e-9"], "check --mass-kg [kg] and"),
        (["--to", "oem", "--epoch", "9" * 5000], "not a time"),
        (["--to", "oem", "--object-id", "<script>"], "give up to 64 letters"),
        (["--to", "urdf", "--pieces", "9" * 30], "give 1 (the convex hull) to 1024"),
        (
            ["--to", "ply", "--cover", "hull"],
            "--cover hull: ply has no collision geometry; the option is for",
        ),
        (["--to", "urdf", "--cover", "all"], "--cover 'all': unknown"),
        (["--to", "ply", "--frame", "Q"], "--frame 'Q': unknown"),
        (["--to", "urdf", "--unit", "mm"], "--unit mm: urdf has lengths of its own"),
        (["--to", "oem", "--poses", "estimated"], "--poses estimated: only tum can have the poses at the"),
        (["--to", "tum", "--poses", "true"], "--poses 'true': unknown; give one of predicted estimated"),
        (["--to", "oem", "--frame", "G"], "an OEM is the path of the centre of mass"),
        (["--to", "oem", "--horizon", "-1"], "--horizon -1: give the seconds"),
        (["--to", "oem", "--epoch", "NaT"], "--epoch NaT: not a time"),
        (["--to", "oem", "--epoch", "1500-01-01"], "--epoch 1500-01-01: give a time from 1900 to 2199"),
        (["--to", "ply", "-o", "/dev/null/all.ply"], "part of this path is a file"),
        ([], "--to"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], words: str, run: Path, tmp_path: Path, capsys: Capture
) -> None:
    output = [] if "-o" in arguments else ["-o", str(tmp_path / "out")]
    assert main(["export", str(run), *arguments, *output]) == 2
    stderr = capsys.readouterr().err
    assert words in stderr and stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_same_run_gives_the_same_bytes(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for to in ("glb", "urdf", "oem"):
        first, second = (export(run, to, tmp_path / f"{name}.{to}", "--horizon", "5") for name in "ab")
        assert first.read_bytes().replace(b"a.urdf_meshes", b"b.urdf_meshes") == second.read_bytes()
    for file in (tmp_path / "a.urdf_meshes").iterdir():
        assert file.read_bytes() == (tmp_path / "b.urdf_meshes" / file.name).read_bytes()


def test_exports_of_one_stem_keep_their_own_meshes(run: Path, tmp_path: Path) -> None:
    export(run, "mjcf", tmp_path / "target.xml", "--mass-kg", "5")
    before = {file: file.read_bytes() for file in (tmp_path / "target.xml_meshes").iterdir()}
    file = export(run, "urdf", tmp_path / "target.urdf", "--frame", "P", "--mass-kg", "5", "--pieces", "1")
    assert {file: file.read_bytes() for file in before} == before and len(before) >= 2
    folder = tmp_path / "target.urdf_meshes"
    assert (folder / "surface.obj").read_bytes() != (tmp_path / "target.xml_meshes/surface.obj").read_bytes()
    assert folder.name in file.read_text()


def test_a_moment_or_a_mass_that_does_not_fit_the_mesh_is_a_warning(
    run: Path, tmp_path: Path, capsys: Capture
) -> None:
    one = ("--horizon", "1")
    fits = document(run, tmp_path, *one, "--mass-kg", "4.5")["inertial"]["moments_kg_m2"][1]
    for share, warned in ((1.0, False), (9.0, True), (1.0 / 400.0, True)):
        options = ("--mass-kg", "4.5", "--middle-moment-kg-m2", repr(share * fits))
        words = document(run, tmp_path, *one, *options)["left_out"]
        assert any("has a radius of gyration of" in line for line in words) == warned
        assert ("has a radius of gyration of" in capsys.readouterr().out) == warned
    for mass_kg, bound in (("1000", "more than that of gold"), ("0.001", "less than that of air")):
        document(run, tmp_path, *one, "--mass-kg", mass_kg)
        words = rf"warning: a density of \S+ kg/m\^3, {bound}: {mass_kg} kg in .* check --mass-kg"
        assert re.search(words, capsys.readouterr().out)
    # a moment alone has no mass to compare with
    assert document(run, tmp_path, *one, "--middle-moment-kg-m2", "1e6")["left_out"] == []
    # what the user gave is no warning, and the answer has it
    mass = f"{800.0 * abs(float(read_ply(run / 'mesh.ply').mesh.volume)):g}"
    path = export(run, "mjcf", tmp_path / "x.xml", "--pieces", "1", "--mass-kg", mass)
    printed = capsys.readouterr().out
    assert "as given" not in printed and "density of" not in printed and "as given" in path.read_text()
    path = export(run, "json", tmp_path / "x.json", *one, "--mass-kg", "2", "--json")
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["files"] == [{"path": str(path), "bytes": path.stat().st_size}]
    properties, written = figures["mass_properties"], json.loads(path.read_text())["inertial"]
    assert properties["mass_is"] == "given" and figures["duration_s"] > 0.0
    assert {name: written[name] for name in properties} == properties


def test_an_epoch_beside_timestamps_that_are_utc_already_is_a_warning(
    example: Example, tmp_path: Path, capsys: Capture
) -> None:
    start_ns = 1_600_000_000 * 10**9
    later = replace(
        example,
        tracks=replace(example.tracks, timestamps_ns=example.tracks.timestamps_ns + start_ns),
        estimate=replace(example.estimate, timestamps_ns=example.estimate.timestamps_ns + start_ns),
    )
    run = stored(tmp_path / "later", later)
    for to in ("oem", "aem", "json"):
        for epoch, warned in (("2026-11-23", True), ("1970-01-01", False)):
            export(run, to, tmp_path / f"x.{to}", "--horizon", "2", "--epoch", epoch)
            assert ("50.7 years after --epoch 2026-11-23" in capsys.readouterr().out) == warned
    export(run, "tum", tmp_path / "x.tum", "--horizon", "2", "--epoch", "2026-11-23")
    assert "--epoch" not in capsys.readouterr().out


def test_known_torques_set_the_scale_whatever_the_mass(example: Example, tmp_path: Path) -> None:
    scale: dict[str, Any] = {"inertia_scale_kg_m2": 0.25, "sigma_inertia_scale_kg_m2": 0.01}
    mass = replace(example.estimate.mass, mass_kg=9.0, sigma_mass_kg=0.1, **scale)
    torqued = replace(example, estimate=replace(example.estimate, mass=mass))
    run = stored(tmp_path / "torqued", torqued, example.surface)
    found = document(run, tmp_path, "--horizon", "1")["inertial"]
    assert (found["mass_is"], found["scale_is"], found["mass_kg"]) == ("determined", "determined", 9.0)
    assert found["moments_kg_m2"][1] == pytest.approx(0.25)
    given = document(run, tmp_path, "--horizon", "1", "--middle-moment-kg-m2", "0.5")["inertial"]
    assert given["scale_is"] == "given" and given["moments_kg_m2"][1] == pytest.approx(0.5)
