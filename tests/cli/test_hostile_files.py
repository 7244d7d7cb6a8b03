"""Hostile images, archives and meshes, for every command that reads them: exit 2, one line, no files."""

import shutil
import struct
import zipfile
import zlib
from pathlib import Path

import pytest

from polhode.cli.main import main
from tests.conftest import MakeOnce
from tests.pipeline.conftest import make_example, write_example

Capture = pytest.CaptureFixture[str]


def _refused(arguments: list[str], capsys: Capture) -> str:
    """The one line on standard error."""
    assert main(arguments) == 2
    line = capsys.readouterr().err
    assert line.startswith("polhode: error: ") and line.count("\n") == 1 and line[:-1].isprintable()
    return line


@pytest.mark.parametrize("command", ["run", "compare"])
@pytest.mark.parametrize(
    ("folder", "message"),
    [
        ("cam0/data", "13000x13000 px instead"),
        ("masks1", "13000x13000 px instead"),
        ("cam1/data", "not an image"),
    ],
)
def test_hostile_images(
    folder: str, message: str, command: str, small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    # a PNG that states its size and ends there
    head = b"IHDR" + struct.pack(">IIBBBBB", 13_000, 13_000, 8, 0, 0, 0, 0)
    start = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))
    png = start + struct.pack(">I", 10**6) + b"IDAT" + bytes(100)
    place = small_sequence / "mav0" / folder
    place.mkdir(exist_ok=True)
    for image in sorted((small_sequence / "mav0" / "cam0" / "data").iterdir()):
        (place / image.name).write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n" if folder == "cam1/data" else png)
    out = tmp_path / "out"
    line = _refused([command, "--data", str(small_sequence), "-o", str(out)], capsys)
    assert message in line and not (out / "summary.json").exists()


def _huge_header(path: Path) -> None:
    """Every array states 745 GiB."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000,)}\n"
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + bytes(64))


def _huge_count(path: Path) -> None:
    """A cloud or a surface of 1e12 vertices."""
    content = path.read_bytes()
    start = content.index(b"element vertex ")
    end = content.index(b"\n", start)
    path.write_bytes(content[:start] + b"element vertex 1000000000000" + content[end:])


CLOUDS = ("landmarks.ply", "mesh.ply")
COMMANDS: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "predict": (["predict", "RUN", "--horizon", "5"], ("covariance.npz",)),
    "report": (["report", "RUN", "-o", "OUT.html"], ("measurements.npz", "covariance.npz", *CLOUDS)),
    "export of a mesh": (["export", "RUN", "--to", "glb", "-o", "OUT.glb"], ("mesh.ply",)),
    "plan": (["plan", "RUN", "-o", "OUT"], ("covariance.npz",)),
    "observability": (["observability", "RUN", "-o", "OUT"], ("mesh.ply",)),
    "compare": (["compare", "--run", "RUN", "-o", "OUT"], ("measurements.npz",)),
}
"""By name: the words, and the files of the run that the command reads."""
FILES = [(command, file) for command, (_, files) in COMMANDS.items() for file in files]


@pytest.fixture(scope="module")
def whole_run(make_once: MakeOnce) -> Path:
    """The run of ``make_example``."""

    def fill(folder: Path) -> None:
        folder.mkdir()
        write_example(folder, make_example())

    return make_once("run_for_hostile_files", fill)


@pytest.mark.parametrize(("command", "file"), FILES)
def test_hostile_files_of_a_run(
    command: str, file: str, whole_run: Path, tmp_path: Path, capsys: Capture
) -> None:
    run = Path(shutil.copytree(whole_run, tmp_path / "run"))
    places = {"RUN": str(run)}
    words = [places.get(word, word.replace("OUT", str(tmp_path / "out"))) for word in COMMANDS[command][0]]
    before = sorted(tmp_path.rglob("*"))
    (_huge_count if file.endswith(".ply") else _huge_header)(run / file)
    assert file in _refused(words, capsys)
    (run / file).write_bytes(b"")
    assert file in _refused(words, capsys)
    made = {path.name for path in tmp_path.rglob("*") if path not in before and path.is_file()}
    # A comparison claims its folder before it reads the run.
    assert made <= {".polhode-output", "config.yaml"}


MESHES: dict[str, tuple[str, bytes]] = {
    "ply of 1e12 vertices": (
        "a.ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n",
    ),
    "stl of 2^32 triangles": ("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50)),
    "glb that ends early": ("a.glb", struct.pack("<5I", 0x46546C67, 2, 2**31, 2**30, 0x4E4F534A)),
    "obj that is a table": ("a.obj", b"1,2,3\n" * 100),
    "step": ("a.step", b"ISO-10303-21;\n"),
}


@pytest.mark.parametrize(
    ("case", "command"),
    [*((case, "observability") for case in MESHES), ("step", "simulate")],
)
def test_hostile_meshes(case: str, command: str, whole_run: Path, tmp_path: Path, capsys: Capture) -> None:
    name, content = MESHES[case]
    path = tmp_path / name
    path.write_bytes(content)
    config = tmp_path / "scene.yaml"
    config.write_text(f"scene: {{frames: 3, body: {{family: mesh, path: {path}, metres_per_unit: 1.0}}}}\n")
    out = str(tmp_path / "out")
    words = {
        "simulate": ["simulate", str(config), "-o", out],
        "observability": ["observability", str(path), "-o", out],
    }
    assert name in _refused(words[command], capsys)
    assert not any(each.is_file() for each in (tmp_path / "out").rglob("*"))
