"""What the commands of the pages are run on: small data under the names that the pages use.

A name is provided when a command is about to read it and nothing is there, so that what an earlier command of
the page has written is used where there is something.
"""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import trimesh

from polhode.calibration.boards import make_board
from polhode.calibration.lenses import Lens
from polhode.records.dataset_writer import write_png
from polhode.records.rig_calibration import read_calibration
from tests.calibration.board_images import BoardCamera, printed
from tests.calibration.rendered_rigs import board_pose
from tests.docs.page_code import ROOT
from tests.importers.recordings import original, write_folders

FRAMES = 8
POSES = "".join(f"{time} 0.0 0.0 {-0.9 + 0.02 * time} 0 0 0 1\n" for time in range(4))
"""A trajectory, TUM format: towards the origin of G along z."""


def small_sequence(rendered: Path, folder: Path) -> None:
    """The first FRAMES pairs of a rendered sequence."""
    shutil.copytree(rendered, folder, copy_function=lambda a, b: Path(b).symlink_to(a))
    for camera in ("cam0", "cam1"):
        table = folder / "mav0" / camera / "data.csv"
        rows = table.read_text().splitlines(keepends=True)
        table.unlink()
        table.write_text("".join(rows[: FRAMES + 1]))


def provide(word: str, folder: Path, sequence: Path, run: Callable[[], Path]) -> None:
    """Make what a word names in the folder, if it is a name that the pages take for granted."""
    name = Path(word).parts[0] if word and not word.startswith("-") else ""
    place = folder / name
    if not name or place.exists() or place.is_symlink():
        return
    if name == "examples":
        # as the repository has them, but the sample is the small sequence
        place.mkdir()
        for path in (ROOT / "examples").iterdir():
            (place / path.name).symlink_to(sequence if path.name == "sample" else path)
    elif name in ("configs", "SEQ"):
        place.symlink_to(sequence if name == "SEQ" else ROOT / name)
    elif name == "RUN":
        shutil.copytree(run(), place)
    elif name in MADE:
        MADE[name](place, sequence)


def _rig(place: Path, sequence: Path) -> None:
    for camera in ("cam0", "cam1"):
        (place / camera).mkdir(parents=True)
        shutil.copy(sequence / "mav0" / camera / "sensor.yaml", place / camera)


def _finished_folder(place: Path, sequence: Path) -> None:
    """A folder that a recorder has filled to its end."""
    shutil.copytree(sequence, place)
    (place / "mav0" / "end").touch()


def _boards(place: Path, sequence: Path) -> None:
    """A chessboard before the cameras of the sequence."""
    rig, recorded = read_calibration(sequence / "mav0"), original(sequence)
    board, random = make_board("chessboard", "9x6", 0.0254), np.random.default_rng(2)
    picture, size = printed(board), (rig.width_px, rig.height_px)
    cameras = [
        BoardCamera(Lens("brown5", np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *dist[:4], 0.0])), size)
        for K, dist in zip(recorded.K, recorded.dist, strict=True)
    ]
    for number in range(1, 8):
        X_0B = board_pose(board, random)
        for side, camera, X in (("left", cameras[0], X_0B), ("right", cameras[1], recorded.X_10 @ X_0B)):
            image = camera.picture(picture, X, 0.7, 1.0, np.random.default_rng(number))
            write_png(place / side / f"{number:02d}.png", image)


def _part_of(make: Callable[[Path, Path], None], part: str) -> Callable[[Path, Path], None]:
    """A folder of what ``make`` makes, for pages that name it without the folder above."""

    def make_part(place: Path, sequence: Path) -> None:
        whole = place.parent / f"whole_{part}"
        make(whole, sequence)
        (whole / part).rename(place)
        shutil.rmtree(whole)

    return make_part


def _cad_model(place: Path, sequence: Path) -> None:
    """Another program's model of the body, in millimetres."""
    mesh = trimesh.load_mesh(sequence / "mav0" / "target0" / "mesh.ply")
    mesh.simplify_quadric_decimation(face_count=500).apply_scale(1000.0).export(place)


def _scene(place: Path, _: Path) -> None:
    """The configuration that docs/simulation.md shows, and the mesh in millimetres that it names."""
    page = (ROOT / "docs" / "simulation.md").read_text()
    place.write_text(page.split("```yaml\n")[1].split("```")[0])
    trimesh.creation.box((300.0, 200.0, 100.0)).export(place.with_suffix(".obj"))


def _recording(place: Path, sequence: Path) -> None:
    write_folders(original(sequence), place)


MADE: Mapping[str, Callable[[Path, Path], object]] = {
    "RIG": _rig,
    "SOURCE": _finished_folder,
    "board": _boards,
    "left": _part_of(_boards, "left"),
    "right": _part_of(_boards, "right"),
    "recording": _recording,
    "LEFT": _part_of(_recording, "left"),
    "RIGHT": _part_of(_recording, "right"),
    "model.stl": _cad_model,
    "model.ply": lambda place, _: trimesh.creation.box((0.3, 0.2, 0.1)).export(place),
    "my_satellite.yaml": _scene,
    "plan.txt": lambda place, _: place.write_text(POSES),
    "poses.txt": lambda place, _: place.write_text(POSES),
}
"""How to make what the pages name, from the sequence"""
