"""The readers that fuzzing calls, each with a small valid corpus that our own writers made.

A target lays a folder out once (a sequence, a run) and then replaces one file in it by each input.
"""

import importlib
import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

Read = Callable[[Path], object]
"""From the file that the input was written to."""


@dataclass(frozen=True)
class Target:
    """One reader of one kind of file."""

    name: str
    file: str
    """Where the input is written, relative to the folder of the target"""
    kind: str
    """How mutation sees it: text, bytes, zip, png, glb, safetensors"""
    seeds: Callable[[], list[bytes]]
    read: Read
    lay_out: Callable[[Path], None] = lambda folder: None
    """Make what else the reader needs"""
    words: tuple[bytes, ...] = ()
    """Tokens of the format"""

    @property
    def format(self) -> str:
        """Format of the file: targets of one format go through the same reader of polhode."""
        if self.name in _FORMATS:
            return _FORMATS[self.name]
        return Path(self.file).suffix.removeprefix(".")


_FORMATS = {
    "command_line": "command line",
    "calibration": "calibration",
    "inspector_sigmas": "calibration",
    "poses_tum": "tum",
    "material_library": "obj",
    "texture": "image",
    "image": "image",
    "mask": "image",
}
"""Of the targets whose files' suffixes do not tell"""

NUMBERS = (
    *b"nan inf -inf 1e308 1e-320 -0 0 -1 1e400 0x10 1_0 2147483648 4294967295 9223372036854775807".split(),
    *b"9223372036854775808 18446744073709551615".split(),
    b"9" * 400,
)
_CONTROL = (b"\n", b"\r", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\xe2\x80\xa8", b"\x1b[2J")
TEXT_WORDS = (*NUMBERS, *_CONTROL, b",", b"#")
YAML_WORDS = (
    *TEXT_WORDS,
    *b"[ ] { } ~ | > null 2024-99-99 ...".split(),
    *(b"&a ", b"*a", b"<<: ", b": ", b"- ", b"? ", b"extends: ", b"%YAML 1.1", b"---\n"),
    *(b"!!python/object/apply:os.system ", b"!!set ", b"!!binary "),
)
JSON_WORDS = (*NUMBERS, *b"null true { } [ ] NaN Infinity".split(), b'"\\ud800"', b'"', b"[" * 500)
OBJ_WORDS = (
    *NUMBERS,
    *(word + b" " for word in b"v vt vn f mtllib usemtl o g".split()),
    b"/",
    b"//",
    b"\\\n",
)
STL_WORDS = (*NUMBERS, b"solid ", b"endsolid", b"vertex ", b"facet normal ")
PLY_WORDS = (
    *NUMBERS,
    *(word + b" " for word in b"element vertex face edge double".split()),
    *(b"property list uchar int ", b"property float ", b"ascii", b"binary_big_endian", b"end_header\n"),
    b"comment TextureFile /etc/passwd\n",
)
PATH_WORDS = (b"../", b"/dev/zero", b"/etc/passwd")


def _call(name: str, *arguments: Any) -> Read:
    """The function ``module:name``, imported when it is first called."""
    module, _, attribute = name.partition(":")

    def read(file: Path) -> object:
        return getattr(importlib.import_module(module), attribute)(file, *arguments)

    return read


# --- the parts of a sequence ------------------------------------------------------------------------------

SIZE = (64, 48)
STAMPS = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(4, dtype=np.int64)


def _sequence(folder: Path) -> None:
    """Four pairs of 64 x 48 px, with poses of the inspector, wrench and masks."""
    from polhode.records.dataset_writer import (
        image_path,
        mask_path,
        write_camera_csv,
        write_png,
        write_sensor,
    )

    rng = np.random.default_rng(7)
    mav0 = folder / "mav0"
    for index in (0, 1):
        K = np.array([[50.0, 0.0, 31.5], [0.0, 51.0, 23.5], [0.0, 0.0, 1.0]])
        X_BC = np.eye(4)
        X_BC[0, 3] = 0.09 * index
        write_sensor(mav0 / f"cam{index}", K, np.array([-0.1, 0.01, 0.0, 0.0]), X_BC, SIZE, rate_hz=2.0)
        write_camera_csv(mav0 / f"cam{index}", STAMPS)
        for stamp in STAMPS:
            image = rng.integers(0, 250, SIZE[::-1]).astype(np.uint8)
            write_png(image_path(mav0 / f"cam{index}", int(stamp)), image)
            write_png(mask_path(mav0, index, int(stamp)), image > 100)


def _poses(columns: int) -> bytes:
    row = {7: "0.1,0.2,0.3,1,0,0,0", 6: "0.1,0,0,0,0,1e-3", 13: "0,0,1,1,0,0,0,0,0,0,0.1,0.2,0.3"}[columns]
    return ("#timestamp [ns],x\n" + "".join(f"{stamp},{row}\n" for stamp in STAMPS)).encode()


def _open_sequence(file: Path) -> object:
    from polhode.records.dataset import open_sequence

    return open_sequence(next(parent for parent in file.parents if (parent / "mav0").is_dir()))


def _of_sequence(file: str) -> Callable[[], list[bytes]]:
    """The file of the sequence as it is written."""

    def seeds() -> list[bytes]:
        with TemporaryDirectory() as folder:
            _sequence(Path(folder))
            return [(Path(folder) / file).read_bytes()]

    return seeds


def _truth(folder: Path) -> None:
    target = folder / "mav0" / "target0"
    target.mkdir(parents=True)
    (target / "data.csv").write_bytes(_poses(13))
    properties = {"moments": [1.2, 1.0, 0.8], "com_G": [0, 0, 0.1], "R_GP": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    (target / "target.yaml").write_text(json.dumps(properties))


def _read_truth(file: Path) -> object:
    from polhode.records.read_truth import read_truth

    return read_truth(file.parents[2])


# --- images ------------------------------------------------------------------------------------------------


def _images() -> list[bytes]:
    from PIL import Image

    grey = np.random.default_rng(0).integers(0, 255, SIZE[::-1]).astype(np.uint8)
    deep = grey.astype(np.uint16) * 16
    found = []
    for values, formats in ((grey, ("PNG", "TIFF", "JPEG", "BMP", "PPM")), (deep, ("PNG", "TIFF", "PPM"))):
        for form in formats:
            stream = io.BytesIO()
            Image.fromarray(values).save(stream, form)
            found.append(stream.getvalue())
    for mode, form, options in (
        ("RGB", "PNG", {}),
        ("P", "PNG", {}),
        ("1", "PNG", {}),
        ("RGBA", "TIFF", {}),
        ("RGB", "JPEG", {"progressive": True}),
        ("RGB", "TIFF", {"compression": "tiff_lzw"}),
        ("L", "TIFF", {"compression": "tiff_adobe_deflate"}),
        ("P", "BMP", {}),
    ):
        stream = io.BytesIO()
        Image.fromarray(grey).convert(mode).save(stream, form, **options)
        found.append(stream.getvalue())
    return found


def _read_image(file: Path) -> None:
    from polhode.files.images import UnreadableImage, bit_depth, has_content, read_raw, to_grey
    from polhode.runtime.errors import InputError

    try:
        raw = read_raw(file, *SIZE)
    except UnreadableImage as error:
        # Becomes the reason why a frame is dropped.
        raise InputError(str(error)) from error
    has_content(to_grey(raw, bit_depth(int(raw.max()))))


def _read_mask(file: Path) -> None:
    from polhode.files.images import UnreadableImage, read_mask
    from polhode.runtime.errors import InputError

    try:
        read_mask(file, *SIZE)
    except UnreadableImage as error:
        raise InputError(str(error)) from error


# --- the parts of a run ------------------------------------------------------------------------------------


def _run(folder: Path) -> None:
    """The run of the tests, on disk: a box that tumbles, estimated in 24 frames."""
    from tests.pipeline.conftest import make_example, write_example

    write_example(folder, make_example(), pictures={"a frame": _images()[0]})


_files_of_run: dict[str, bytes] = {}


def _of_run(*names: str) -> Callable[[], list[bytes]]:
    """Files of the run as it is written."""

    def seeds() -> list[bytes]:
        if not _files_of_run:
            with TemporaryDirectory() as folder:
                run = Path(folder) / "run"
                run.mkdir()
                _run(run)
                for file in run.rglob("*"):
                    if file.is_file():
                        _files_of_run[file.relative_to(run).as_posix()] = file.read_bytes()
        return [_files_of_run[name] for name in names]

    return seeds


def _lay_out_run(folder: Path) -> None:
    _of_run("summary.json")()
    for name, content in _files_of_run.items():
        _write(folder / "run" / name, content)


def _read_run(file: Path) -> object:
    from polhode.run_directory.stored_run import read_stored_run

    return read_stored_run(next(each for each in file.parents if each.name == "run"), "run")


def _archive(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _pixel_truth() -> list[bytes]:
    h, w = 6, 8
    return [
        _archive(depth=np.ones((h, w), "f4"), shadow=np.zeros((h, w), "u1")),
        _archive(normals=np.zeros((h, w, 3), "f4"), mask=np.ones((h, w), bool), albedo=np.ones((h, w), "f4")),
    ]


def _causal_estimate() -> list[bytes]:
    n, eye = 3, np.eye(3)
    vectors = {name: np.ones((n, 3)) for name in ("r_N", "v_N", "w_P", "com_G")}
    matrices = {name: np.tile(eye, (n, 1, 1)) for name in ("R_NP", "R_GP", "cov_com_G", "cov_R_GP")}
    return [
        _archive(
            timestamps_ns=STAMPS[:n],
            covariance=np.tile(np.eye(12), (n, 1, 1)),
            X_NG=np.tile(np.eye(4), (n, 1, 1)),
            k=np.ones((n, 2)),
            cov_k=np.full((n, 2, 2), np.inf),
            determined=np.ones((n, 4), bool),
            **vectors,
            **matrices,
        )
    ]


# --- meshes ------------------------------------------------------------------------------------------------


def _meshes(kind: str) -> Callable[[], list[bytes]]:
    def seeds() -> list[bytes]:
        import trimesh

        box = trimesh.creation.box([0.2, 0.3, 0.4])
        tetrahedron = trimesh.Trimesh(
            np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
        )
        coloured = tetrahedron.copy()
        coloured.visual.vertex_colors = [200, 10, 10, 255]
        found = [_bytes(mesh.export(file_type=kind)) for mesh in (box, tetrahedron, coloured)]
        if kind == "ply":
            found += [_bytes(coloured.export(file_type="ply", encoding="ascii"))]
        if kind == "stl":
            found += [_bytes(tetrahedron.export(file_type="stl_ascii"))]
        if kind == "obj":
            found += [
                b"mtllib a.mtl\no part\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\n"
                b"vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
                b"usemtl gold\nf 1/1/1 2/2/1 3/3/1\ng more\nf 1 2 3\nf -1 -2 -3\n",
                b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 4\nf 1 2 5\nf 1 2 3 4 5\n",
            ]
        if kind == "glb":
            scene = trimesh.Scene()
            scene.add_geometry(
                box, node_name="wing", transform=trimesh.transformations.translation_matrix([1, 0, 0])
            )
            scene.add_geometry(coloured, node_name="nozzle")
            found += [_bytes(scene.export(file_type="glb"))]
        return found

    return seeds


def _bytes(content: Any) -> bytes:
    return content.encode() if isinstance(content, str) else bytes(content)


def _read_mesh(file: Path) -> None:
    """As a CAD model and as a simulated body."""
    from polhode.mapping.mesh_files import read_mesh
    from polhode.runtime.errors import InputError
    from polhode.simulation.bodies.mesh_file import file_appearance, read_pieces

    refused: InputError | None = None
    try:
        read_mesh(file, 1.0)
    except InputError as error:
        refused = error
    for piece in read_pieces(file, 1.0):
        file_appearance(piece, file.suffix == ".glb")
    if refused is not None:
        raise refused


def _textured(folder: Path) -> None:
    _write(
        folder / "mesh.obj",
        b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n",
    )
    _write(folder / "skin.png", _images()[0])


def _read_textured(file: Path) -> None:
    _read_mesh(file.with_name("mesh.obj"))


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


# --- others ------------------------------------------------------------------------------------------------


def _configurations() -> list[bytes]:
    from lab.command import ROOT

    body = b"  body: {family: bus, size_m: 0.4}\n"
    short = b"seed: 3\nscene:\n  frames: 8\n" + body + b"  motion:\n    spin_rpm: [1.0, 2.0, 0.5]\n"
    names = (
        "configs/default.yaml",
        "configs/sample.yaml",
        "configs/scenes/known_torque.yaml",
        "configs/compare/short.yaml",
    )
    return [short, *((ROOT / name).read_bytes() for name in names)]


def _read_overrides(file: Path) -> object:
    """The lines of the file as words of a command line."""
    from polhode.cli.parsing import parse
    from polhode.cli.run import RunCommand
    from polhode.config.loader import load_config

    words = file.read_bytes().decode("utf-8", errors="surrogateescape").replace("\0", "").split("\n")
    _, overrides = parse("run", RunCommand, ["-o", "run", *words])
    return load_config(None, overrides)


def _tensors() -> list[bytes]:
    header = json.dumps({"a": {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 24]}}).encode()
    return [struct.pack("<Q", len(header)) + header + bytes(24)]


def _read_tensors(file: Path) -> object:
    import torch

    from polhode.frontend.networks.tensor_file import TensorFileError, read_tensors
    from polhode.runtime.errors import InputError

    try:
        return read_tensors(file, {"a": torch.zeros(2, 3)})
    except TensorFileError as error:
        # Both callers put it into one line of InputError.
        raise InputError(str(error)) from None


def _comparisons() -> list[bytes]:
    content = {
        "schema": "polhode-compare/1",
        "limit_s": 60.0,
        "machine": "m",
        "versions": {"casadi": "3"},
        "problems": [],
        "rows": [],
        "profiles": [],
    }
    return [json.dumps(content).encode()]


def _table_of_run(name: str) -> Callable[[], list[bytes]]:
    """The first rows of a table."""

    def seeds() -> list[bytes]:
        return [b"\n".join(_of_run(name)()[0].split(b"\n")[:4]) + b"\n"]

    return seeds


def _tum() -> list[bytes]:
    return [b"# t x y z qx qy qz qw\n0.0 0 0 1 0 0 0 1\n0.5 0.1 0 1 0 0 0.1 0.995\n1,0,0,1,0,0,0,1\n"]


_WORDS = b"--backend.inertia\nratios_axes\n--seed=4\n--scene.motion.spin_rpm\n[1,2,3]"
_PROPERTIES = (
    b"moments: [1.2, 1.0, 0.8]\nk1: 0.18\nk2: 0.22\ncom_G: [0, 0, 0.1]\nR_GP: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
    b"mass_kg: 3\n"
)
_METRICS = b'{"rmse_position_m": 1.25e-4, "nees": {"inertia": null}}'
_MATERIAL = b"newmtl m\nKd 1 0.5 0.2\nNs 30\nmap_Kd skin.png\n"


def _in_sequence(name: str, file: str, words: tuple[bytes, ...], seed: bytes | None = None) -> Target:
    """A file of a sequence that its opening reads; the seed as our writer has it unless given."""

    def lay_out(folder: Path) -> None:
        _sequence(folder)
        if name == "inspector_sigmas":
            _write(folder / "mav0/inspector0/data.csv", _poses(7))

    seeds = _of_sequence(f"mav0/{file}") if seed is None else lambda: [seed]
    return Target(name, f"mav0/{file}", "text", seeds, _open_sequence, lay_out, words)


def _textured_with_library(folder: Path) -> None:
    _textured(folder)
    _write(folder / "a.mtl", b"newmtl m\nmap_Kd skin.png\n")


_CONFIG_LOADER, _RUN_FILES = "polhode.config.loader", "polhode.run_directory"
TARGETS: tuple[Target, ...] = (
    Target("configuration", "config.yaml", "text", _configurations,
           _call(f"{_CONFIG_LOADER}:load_config"), words=YAML_WORDS),
    Target("command_line", "words", "text", lambda: [_WORDS], _read_overrides, words=YAML_WORDS),
    _in_sequence("calibration", "cam0/sensor.yaml", YAML_WORDS),
    _in_sequence("camera_table", "cam1/data.csv", (*TEXT_WORDS, *PATH_WORDS, b".png")),
    _in_sequence("inspector_table", "inspector0/data.csv", TEXT_WORDS, _poses(7)),
    _in_sequence("inspector_sigmas", "inspector0/sensor.yaml", YAML_WORDS,
           b"sigma_p_m: 0.001\nsigma_theta_rad: 1e-4\n"),
    _in_sequence("wrench_table", "wrench0/data.csv", TEXT_WORDS, _poses(6)),
    Target("truth_table", "mav0/target0/data.csv", "text", lambda: [_poses(13)], _read_truth, _truth,
           TEXT_WORDS),
    Target("truth_properties", "mav0/target0/target.yaml", "text", lambda: [_PROPERTIES], _read_truth,
           _truth, YAML_WORDS),
    Target("truth_mesh", "mav0/target0/mesh.ply", "bytes", _meshes("ply"), _read_truth, _truth, PLY_WORDS),
    Target("image", "image.png", "png", _images, _read_image),
    Target("mask", "mask.png", "png", _images, _read_mask),
    Target("trajectory", "trajectory.csv", "text", _table_of_run("trajectory.csv"),
           _call(f"{_RUN_FILES}.trajectory_file:read_trajectory"), words=TEXT_WORDS),
    Target("measurements", "measurements.npz", "zip", _of_run("measurements.npz"),
           _call(f"{_RUN_FILES}.archives:read_measurements")),
    Target("residuals", "measurements.npz", "zip", _of_run("measurements.npz"),
           _call(f"{_RUN_FILES}.archives:read_residuals")),
    Target("covariance", "covariance.npz", "zip", _of_run("covariance.npz"),
           _call(f"{_RUN_FILES}.archives:read_covariance")),
    Target("online", "online.npz", "zip", _causal_estimate, _call(f"{_RUN_FILES}.archives:read_online")),
    Target("pixel_truth", "truth.npz", "zip", _pixel_truth,
           _call("polhode.simulation.dataset.frame_renderer:read_products")),
    Target("summary", "summary.json", "text", _of_run("summary.json"),
           _call(f"{_RUN_FILES}.summary:read_summary"), words=JSON_WORDS),
    Target("metrics", "run/metrics.json", "text", lambda: [_METRICS], _read_run, _lay_out_run, JSON_WORDS),
    Target("captions", "run/pictures/captions.json", "text", lambda: [b'{"00.png": "a frame"}'],
           _read_run, _lay_out_run, (*JSON_WORDS, *PATH_WORDS, b"00.png")),
    Target("comparison", "compare.json", "text", _comparisons,
           _call("polhode.compare.rows:read_comparison"), words=JSON_WORDS),
    Target("landmarks", "landmarks.ply", "bytes", _of_run("landmarks.ply"),
           _call(f"{_RUN_FILES}.point_cloud_file:read_landmarks"), words=PLY_WORDS),
    Target("run_mesh", "mesh.ply", "bytes", _of_run("mesh.ply"),
           _call("polhode.mapping.mesh_files:read_ply"), words=PLY_WORDS),
    Target("mesh_ply", "mesh.ply", "bytes", _meshes("ply"), _read_mesh, words=PLY_WORDS),
    Target("mesh_stl", "mesh.stl", "bytes", _meshes("stl"), _read_mesh, words=STL_WORDS),
    Target("mesh_obj", "mesh.obj", "text", _meshes("obj"), _read_mesh, words=OBJ_WORDS),
    Target("mesh_glb", "mesh.glb", "glb", _meshes("glb"), _read_mesh, words=JSON_WORDS),
    Target("material_library", "a.mtl", "text", lambda: [_MATERIAL], _read_textured, _textured, (*NUMBERS,
           *PATH_WORDS, b"newmtl ", b"map_Kd ", b"Kd ", b"Ns ")),
    Target("texture", "skin.png", "png", _images, _read_textured, _textured_with_library),
    Target("weights", "w.safetensors", "safetensors", _tensors, _read_tensors, words=(*JSON_WORDS,
           *b'"F32" "BF16" data_offsets __metadata__'.split())),
    Target("poses_tum", "poses.txt", "text", _tum,
           _call("polhode.planning.observability.assess:read_poses"), words=TEXT_WORDS),
)  # fmt: skip


def share_of(name: str) -> float:
    """The share of a target in the time of its format, which its targets divide evenly."""
    wanted = target_named(name).format
    return 1.0 / sum(each.format == wanted for each in TARGETS)


def target_named(name: str) -> Target:
    """Raises SystemExit for an unknown name."""
    for target in TARGETS:
        if target.name == name:
            return target
    raise SystemExit(f"{name}: no such target; they are {', '.join(each.name for each in TARGETS)}")
