"""What ``polhode export`` writes, read by the programs that it is meant for.

`make test` installs them (extras ``export`` and ``formats``, Drake, the Khronos validator). evo, under the
GPL, runs as a process of its own. SDF is read by Drake, whose parser is Gazebo's libsdformat.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from polhode.geometry.lie import matrix_from_wxyz
from polhode.planning.exports import convex_pieces
from polhode.planning.exports.convex_pieces import clip, outside
from polhode.planning.exports.job import shape_of_surface
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.surface import SurfaceModel
from tests.pipeline.conftest import Example
from tests.pipeline.stored_run import stored
from tests.planning.test_export import document, export

ROOT = Path(__file__).parents[2]
VALIDATOR = ROOT / ".venv" / "gltf" / "node_modules" / "gltf-validator"
VALIDATE = """
const validator = require(process.argv[1]), fs = require('fs');
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])))
  .then(report => console.log(JSON.stringify(report)));
"""


@pytest.fixture(scope="module")
def cross() -> SurfaceModel:
    """A body that is not convex: three beams, bumpy, and open on one side."""
    beams = [trimesh.creation.box(np.roll([0.5, 0.08, 0.06], k)) for k in range(3)]
    mesh = trimesh.util.concatenate(beams)
    assert isinstance(mesh, trimesh.Trimesh)
    for _ in range(3):
        mesh = mesh.subdivide()
    mesh.update_faces(mesh.triangles_center[:, 2] > -0.24)
    mesh.remove_unreferenced_vertices()
    bumps = np.random.default_rng(1).normal(0.0, 3e-4, mesh.vertices.shape)
    mesh = trimesh.Trimesh(mesh.vertices + bumps, mesh.faces, process=False)
    count = len(mesh.vertices)
    return SurfaceModel(mesh, np.full(count, 5e-4), np.full(count, 8, dtype=np.int64))


@pytest.fixture(scope="module")
def cross_run(example: Example, cross: SurfaceModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The motion of the box with this surface."""
    return stored(tmp_path_factory.mktemp("runs") / "cross", example, cross)


def pieces_of(folder: Path) -> list[trimesh.Trimesh]:
    return [trimesh.load_mesh(file) for file in sorted(folder.glob("collision_*.obj"))]


def test_fcl_finds_every_point_of_the_surface_inside_the_pieces(
    cross_run: Path, cross: SurfaceModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_pieces, "VOXELS", 50_000)
    fcl = pytest.importorskip("fcl")
    pytest.importorskip("vhacdx")
    export(cross_run, "urdf", tmp_path / "cross.urdf", "--pieces", "16")
    pieces = pieces_of(tmp_path / "cross.urdf_meshes")
    assert 3 <= len(pieces) <= 16 and all(piece.is_convex and piece.is_volume for piece in pieces)
    manager = fcl.DynamicAABBTreeCollisionManager()
    bodies = []
    for piece in pieces:
        sides = np.column_stack([np.full(len(piece.faces), 3), piece.faces]).ravel()
        bodies.append(fcl.CollisionObject(fcl.Convex(piece.vertices, len(piece.faces), sides)))
    manager.registerObjects(bodies)
    manager.setup()

    def touches(points: np.ndarray, radius_m: float) -> np.ndarray:
        ball = fcl.Sphere(radius_m)
        found = []
        for point in points:
            data = fcl.CollisionData()
            manager.collide(
                fcl.CollisionObject(ball, fcl.Transform(point)), data, fcl.defaultCollisionCallback
            )
            found.append(data.result.is_collision)
        return np.array(found)

    on_surface, _ = trimesh.sample.sample_surface(cross.mesh, 2000, seed=3)
    assert touches(np.asarray(on_surface), 1e-6).all()
    # and what is well away from the body is free: between the beams there is room
    box = np.random.default_rng(2).uniform(-0.3, 0.3, (1500, 3))
    away = box[distance_to_surface(cross.mesh, box) > 0.05]
    share = float(touches(away, 1e-3).mean())
    hull = ConvexHull(np.asarray(cross.mesh.vertices)).equations
    inside_hull = float((outside(away, hull) < 0.0).mean())
    assert len(away) > 500 and share < 0.1 * inside_hull


def test_the_pieces_contain_the_surface_and_reach_little_beyond(
    cross: SurfaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    # coarse first pieces: what is asked here is how they are mended
    monkeypatch.setattr(convex_pieces, "VOXELS", 50_000)
    shape = shape_of_surface(cross, np.eye(4))
    pytest.importorskip("vhacdx")
    samples, _ = trimesh.sample.sample_surface(cross.mesh, 20_000, seed=5)
    points = np.concatenate([np.asarray(samples), shape.vertices])
    reached = []
    for most in (1, 4, 64):
        found = convex_pieces.decompose(shape.mesh(), most)
        assert len(found.pieces) <= most
        planes = [ConvexHull(np.asarray(piece.vertices)).equations for piece in found.pieces]
        assert np.stack([outside(points, each) for each in planes]).min(axis=0).max() < 1e-9
        reached.append(found.max_beyond_m / found.diameter_m)
    assert reached[0] > reached[1] > reached[2] and found.far_share == 0.0
    # within 1 % of the diameter
    assert found.max_beyond_m < 0.01 * found.diameter_m and found.diameter_m == pytest.approx(0.5, rel=0.05)


def test_a_plane_cuts_triangles_into_parts_of_the_same_area() -> None:
    triangles = np.random.default_rng(3).normal(size=(500, 3, 3))
    n = np.array([0.36, 0.48, 0.8])
    below, above = clip(triangles, n, 0.1)
    assert (below @ n).max() < 0.1 + 1e-12 and (above @ n).min() > 0.1 - 1e-12

    def area(t: np.ndarray) -> float:
        return float(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum())

    assert area(below) + area(above) == pytest.approx(area(triangles), rel=1e-12)


def test_without_vhacd_there_is_the_convex_hull_and_it_is_said(
    cross: SurfaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "vhacdx", None)
    found = convex_pieces.decompose(cross.mesh, 16)
    assert len(found.pieces) == 1 and "V-HACD is not installed" in found.description
    flat = trimesh.creation.box((1.0, 1.0, 0.0))
    count = len(flat.vertices)
    plate = SurfaceModel(flat, np.ones(count), np.ones(count, dtype=np.int64))
    with pytest.raises(ValueError, match="flat"):
        convex_pieces.decompose(plate.mesh, 1)


def test_oem_readers_find_states_and_covariances(run: Path, tmp_path: Path) -> None:
    oem = pytest.importorskip("oem")
    ccsds_ndm = pytest.importorskip("ccsds_ndm")
    options = ("--horizon", "10", "--epoch", "2026-03-01T00:00:00")
    file = export(run, "oem", tmp_path / "box.oem", *options, "--object-id", "1999-025A")
    content = document(run, tmp_path, *options)
    rows = [content["last"], *content["prediction"]]
    message = oem.OrbitEphemerisMessage.open(str(file))
    (segment,) = message.segments
    states, covariances = list(segment.states), list(segment.covariances)
    assert len(states) == len(covariances) == len(rows)
    assert segment.metadata["OBJECT_ID"] == "1999-025A" and segment.metadata["TIME_SYSTEM"] == "UTC"
    assert states[0].epoch.isot.startswith("2026-03-01T00:00:1")
    for state, covariance, row in zip(states, covariances, rows, strict=True):
        np.testing.assert_allclose(1e3 * np.array(state.position), row["r_N"], atol=1e-9)
        np.testing.assert_allclose(1e3 * np.array(state.velocity), row["v_N"], atol=1e-9)
        expected = np.array(row["covariance"])[:6, :6]
        np.testing.assert_allclose(1e6 * covariance.matrix, expected, atol=1e-12)
        assert np.linalg.eigvalsh(covariance.matrix).min() > 0.0
    ccsds_ndm.Oem.from_file(str(file)).validate()
    assert max(map(len, file.read_text().splitlines())) <= 254
    # the second state is where the first one's velocity leads
    step = (states[1].epoch - states[0].epoch).sec
    there = np.array(states[0].position) + step * np.array(states[0].velocity)
    np.testing.assert_allclose(there, states[1].position, atol=1e-9)


def test_a_ccsds_library_validates_the_aem_and_its_rates_turn_the_attitude(run: Path, tmp_path: Path) -> None:
    frame, ccsds_ndm = "G", pytest.importorskip("ccsds_ndm")
    options = ("--frame", frame, "--step-s", "0.01", "--horizon", "1")
    message = ccsds_ndm.Aem.from_file(str(export(run, "aem", tmp_path / "box.aem", *options)))
    message.validate()
    (segment,) = message.segments
    about = segment.metadata
    assert (about.ref_frame_b, about.angvel_frame) == ("SC_BODY_1", "SC_BODY_1")
    assert ccsds_ndm.Aem.from_str(message.to_str("xml")).to_str("kvn") == message.to_str("kvn")
    values = np.array([state.values for state in segment.data.attitude_states])
    assert values.shape == (101, 7)
    states = document(run, tmp_path, *options)
    wxyz = np.array([row["q_NF_wxyz"] for row in [states["last"], *states["prediction"]]])
    # the standard's matrix turns coordinates in A = N into those in B: written out from its own definition
    x, y, z, c = values[:, :4].T
    M = np.moveaxis(
        np.array(
            [
                [x * x - y * y - z * z + c * c, 2 * (x * y + z * c), 2 * (x * z - y * c)],
                [2 * (x * y - z * c), -x * x + y * y - z * z + c * c, 2 * (y * z + x * c)],
                [2 * (x * z + y * c), 2 * (y * z - x * c), -x * x - y * y + z * z + c * c],
            ]
        ),
        2,
        0,
    )
    np.testing.assert_allclose(M, np.swapaxes(matrix_from_wxyz(wxyz), 1, 2), atol=1e-9)
    # dM/dt = -w x M, with w of B relative to A along B, in degrees
    slope = (M[2:] - M[:-2]) / 0.02
    w = np.deg2rad(values[1:-1, 4:])
    np.testing.assert_allclose(
        slope, -np.cross(w[:, None], np.swapaxes(M[1:-1], 1, 2)).swapaxes(1, 2), atol=1e-3
    )


def test_evo_reads_the_tum_file(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("evo")
    file = export(run, "tum", tmp_path / "box.tum", "--horizon", "20")
    script = (
        "import sys, json; from evo.tools.file_interface import read_tum_trajectory_file as read;"
        "t = read(sys.argv[1]); ok, why = t.check();"
        "print(json.dumps([ok, t.timestamps.tolist(), t.positions_xyz.tolist(),"
        " t.orientations_quat_wxyz.tolist()]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(file)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    ok, times, places, quaternions = json.loads(done.stdout.splitlines()[-1])
    content = document(run, tmp_path, "--horizon", "20", "--frame", "P")
    rows = [content["last"], *content["prediction"]]
    assert ok and len(times) == len(rows) == 41
    np.testing.assert_allclose(times, [1e-9 * row["timestamp_ns"] for row in rows], atol=1e-6)
    np.testing.assert_allclose(places, [row["p_NF"] for row in rows], atol=1e-9)
    np.testing.assert_allclose(places, [row["r_N"] for row in rows], atol=1e-9)
    np.testing.assert_allclose(
        matrix_from_wxyz(quaternions), matrix_from_wxyz([row["q_NF_wxyz"] for row in rows]), atol=1e-9
    )


@pytest.mark.parametrize("to", ["sdf", "urdf"])
def test_drake_accepts_sdf_and_urdf_with_their_meshes(
    to: str, cross_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_pieces, "VOXELS", 50_000)
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    from pydrake.geometry import Role, SceneGraph
    from pydrake.multibody.plant import MultibodyPlant

    options = ("--mass-kg", "4.5", "--frame", "P", "--pieces", "8", "--horizon", "1")
    file = export(cross_run, to, tmp_path / f"cross.{to}", *options)
    plant, scene = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene)
    (model,) = parsing.Parser(plant, scene).AddModels(str(file))
    plant.Finalize()
    body = plant.GetBodyByName("link" if to == "sdf" else "target")
    spatial = body.default_spatial_inertia()
    content = document(cross_run, tmp_path, *options)
    assert plant.GetModelInstanceName(model) == "target" and spatial.get_mass() == 4.5
    assert spatial.IsPhysicallyValid()
    # in frame P the centre of mass is the origin and the axes are principal
    np.testing.assert_allclose(spatial.get_com(), 0.0, atol=1e-9)
    inertia = spatial.CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(inertia, np.diag(content["inertial"]["moments_kg_m2"]), atol=1e-9)
    inspector = scene.model_inspector()
    pieces = len(list((tmp_path / f"cross.{to}_meshes").glob("collision_*.obj")))
    assert inspector.NumGeometriesWithRole(Role.kProximity) == pieces
    assert inspector.NumGeometriesWithRole(Role.kIllustration) == 1
    if to == "sdf":
        X_NF = plant.GetDefaultFloatingBaseBodyPose(body).GetAsMatrix4()
        np.testing.assert_allclose(X_NF[:3, 3], content["last"]["p_NF"], atol=1e-9)
        np.testing.assert_allclose(X_NF[:3, :3], matrix_from_wxyz(content["last"]["q_NF_wxyz"]), atol=1e-9)


@pytest.fixture(params=["millimetres", "points"])
def a_glb(request: pytest.FixtureRequest, cross_run: Path, bare: Path, tmp_path: Path) -> Path:
    if request.param == "points":
        return export(bare, "glb", tmp_path / "points.glb")
    return export(cross_run, "glb", tmp_path / "mesh.glb", "--unit", "mm")


def glb_content(file: Path) -> tuple[dict[str, Any], bytes, list[np.ndarray]]:
    """The JSON chunk, the binary one, and the arrays of all accessors."""
    raw = file.read_bytes()
    size = int(np.frombuffer(raw[12:16], "<u4")[0])
    content, binary, arrays = json.loads(raw[20 : 20 + size]), raw[28 + size :], []
    types, widths = {5126: "<f4", 5121: "u1", 5125: "<u4"}, {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
    for accessor in content["accessors"]:
        view = content["bufferViews"][accessor["bufferView"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        array = np.frombuffer(part, types[accessor["componentType"]])
        arrays.append(array.reshape(-1, widths[accessor["type"]]))
    return content, binary, arrays


def test_the_khronos_validator_passes(a_glb: Path) -> None:
    node = shutil.which("node")
    if node is None or not VALIDATOR.is_dir():
        pytest.skip("node and gltf-validator are not there (make test installs it where there is npm)")
    done = subprocess.run(
        [node, "-e", VALIDATE, str(VALIDATOR), str(a_glb)], capture_output=True, text=True, check=True
    )
    issues = json.loads(done.stdout)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_the_glb_keeps_the_rules_of_the_standard(a_glb: Path) -> None:
    raw = a_glb.read_bytes()
    magic, version, length = raw[:4], *np.frombuffer(raw[4:12], "<u4")
    size, kind = np.frombuffer(raw[12:16], "<u4")[0], raw[16:20]
    assert (magic, version, length, kind) == (b"glTF", 2, len(raw), b"JSON") and size % 4 == 0
    content, binary, arrays = glb_content(a_glb)
    assert content["buffers"][0]["byteLength"] == len(binary)
    assert all(view["byteOffset"] % 4 == 0 for view in content["bufferViews"])
    for accessor, array in zip(content["accessors"], arrays, strict=True):
        assert len(array) == accessor["count"] and np.isfinite(array).all()
        if "min" in accessor:
            np.testing.assert_array_equal(array.min(axis=0), np.array(accessor["min"], array.dtype))
            np.testing.assert_array_equal(array.max(axis=0), np.array(accessor["max"], array.dtype))
    for mesh in content["meshes"]:
        (primitive,) = mesh["primitives"]
        counts = {len(arrays[k]) for k in primitive["attributes"].values()}
        assert len(counts) == 1
        assert "indices" not in primitive or arrays[primitive["indices"]].max() < counts.pop()
