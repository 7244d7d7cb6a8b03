"""The dataset of ``polhode simulate`` on its way to the disk, and which folders that command made.

The files of a frame are written to a temporary folder and then moved: a frame is complete or absent.
"""

import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from polhode.config.loader import load_config
from polhode.files.output.exchange import foreign, is_regular
from polhode.files.output.resumable_dataset import DatasetMaker
from polhode.runtime.errors import InputError
from polhode.simulation.motion.target import timestamps

SCENE_FILE = "scene.yaml"
"""The configuration that made the dataset, beside mav0/."""
FINGERPRINT, FRAMES = ".made_by", ".frames"

_DATASET = re.compile(
    r"scene\.yaml"
    r"|mav0/((?:cam[01]|range0)/(sensor\.yaml|data\.csv|data/\d+\.png)|masks[01]/\d+\.png|truth[01]/\d+\.npz"
    r"|inspector0/(sensor\.yaml|data\.csv)|wrench0/data\.csv|calibration_covariance\.npz|target0/(data\.csv|target\.yaml|mesh\.ply))"
)
_STAMPED = re.compile(r"mav0/(?:cam[01]/data|range0/data|masks[01]|truth[01])/(\d+)\.(?:png|npz)")
_STAGING = re.compile(rf"{re.escape(FINGERPRINT)}|{re.escape(FRAMES)}/\d+\.(done|partial)")
_FRAME = re.compile(rf"{re.escape(FRAMES)}/\d+/(.+)")
_PARTIAL = re.compile(r"\.([^/.]+)\.partial-\d+(\.\w+)$")


@dataclass(frozen=True)
class StagedDataset:
    """A dataset in its hidden folder. Several processes may write to it, each frame from one of them."""

    path: Path

    @property
    def mav0(self) -> Path:
        """Folder of the dataset's files."""
        return self.path / "mav0"

    def missing(self, frames: Iterable[int]) -> list[int]:
        """The frames that are not complete yet."""
        return [k for k in frames if not self._has(k)]

    @contextmanager
    def frame(self, k: int) -> Iterator[Path]:
        """A temporary folder for frame k, laid out as mav0; its files move there if the block succeeds."""
        aside = self.path / FRAMES / str(k)
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir(parents=True)
        yield aside
        files = sorted(path.relative_to(aside) for path in aside.rglob("*") if path.is_file())
        sizes = "".join(f"{(aside / name).stat().st_size} {name.as_posix()}\n" for name in files)
        for name in files:
            (self.mav0 / name).parent.mkdir(parents=True, exist_ok=True)
            (aside / name).replace(self.mav0 / name)
        shutil.rmtree(aside)
        note = aside.with_suffix(".partial")
        note.write_text(sizes, encoding="utf-8")
        note.replace(note.with_suffix(".done"))

    def _has(self, k: int) -> bool:
        """Whether the frame's record exists, and every file that it lists has the recorded length."""
        try:
            lines = (self.path / FRAMES / f"{k}.done").read_text(encoding="utf-8").splitlines()
            sizes = (line.split(" ", 1) for line in lines)
            return all((self.mav0 / name).stat().st_size == int(size) for size, name in sizes)
        except OSError:
            return False


def _is_own_file(name: str) -> bool:
    """Whether ``simulate`` writes a file of this name into the hidden folder."""
    frame = _FRAME.fullmatch(name)
    if frame is not None:
        name = "mav0/" + _PARTIAL.sub(r"\1\2", frame[1])
    return _DATASET.fullmatch(name) is not None or _STAGING.fullmatch(name) is not None


def why_not_ours(folder: Path) -> str:
    """What speaks against a folder being a dataset of ``simulate`` and nothing else; empty: nothing does.

    It holds what ``simulate`` writes, under the names and times that its scene gives.
    """
    for name in (SCENE_FILE, "mav0/target0/target.yaml"):
        if not ((folder / name).is_file() and is_regular(folder / name)):
            return f"it has no {name}"
    others = foreign(folder, lambda name: _DATASET.fullmatch(name) is not None)
    if others:
        return f"it holds {others[0]}"
    try:
        scene = load_config(folder / SCENE_FILE).scene
    except InputError:
        return f"its {SCENE_FILE} cannot be read"
    if scene is None:
        return f"its {SCENE_FILE} has no scene"
    stereo = scene.ranges is None
    on_request = {
        "masks0": scene.render.masks,
        "masks1": scene.render.masks and stereo,
        "truth0": bool(scene.render.products),
        "truth1": bool(scene.render.products) and stereo,
        "cam1": stereo,
        "range0": not stereo,
        "inspector0": scene.inspector.moves and scene.inspector.reported,
        "wrench0": bool(scene.motion.pushes) and scene.motion.pushes_known,
    }
    known = {int(stamp) for stamp in timestamps(scene)}
    for path in sorted((folder / "mav0").rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not on_request.get(name.split("/")[1], True):
            return f"its {SCENE_FILE} does not ask for {name}"
        stamped = _STAMPED.fullmatch(name)
        if stamped and int(stamped[1]) not in known:
            return f"its {SCENE_FILE} is of other images than {name}"
    return ""


SIMULATED = DatasetMaker("simulate", _is_own_file, why_not_ours, FINGERPRINT)
require_free = SIMULATED.require_free


@contextmanager
def staged_dataset(
    folder: Path, overwrite: bool, fingerprint: str, frames: int = 0
) -> Iterator[StagedDataset]:
    """A new or resumed staged dataset of ``frames`` pairs that replaces ``folder`` if the block succeeds."""

    def kept(path: Path) -> str:
        done = len(list((path / FRAMES).glob("*.done")))
        return f"{done} of {frames} pairs" if done else ""

    with SIMULATED.staged(folder, overwrite, fingerprint, kept) as path:
        yield StagedDataset(path)
        shutil.rmtree(path / FRAMES, ignore_errors=True)
