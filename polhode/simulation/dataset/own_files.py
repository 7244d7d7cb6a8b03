"""Which folders ``polhode simulate`` made: what it writes, under the names and times that its scene gives."""

import re
from pathlib import Path

from polhode.config.loader import load_config
from polhode.config.scene_settings import Scene
from polhode.files.output.exchange import foreign, is_regular
from polhode.runtime.errors import InputError
from polhode.simulation.motion.target import timestamps

SCENE_FILE = "scene.yaml"
"""The configuration that made the dataset, beside mav0/."""
FINGERPRINT = ".made_by"
FRAMES = ".frames"

_DATASET = re.compile(
    r"mav0/((?:cam[01]|range0)/(sensor\.yaml|data\.csv|data/\d+\.png)|masks[01]/\d+\.png|truth[01]/\d+\.npz"
    r"|inspector0/(sensor\.yaml|data\.csv)|wrench0/data\.csv|target0/(data\.csv|target\.yaml|mesh\.ply))"
)
_STAMPED = re.compile(r"mav0/(?:cam[01]/data|range0/data|masks[01]|truth[01])/(\d+)\.(?:png|npz)")
_STAGING = re.compile(rf"{re.escape(FINGERPRINT)}|{re.escape(FRAMES)}/\d+\.(done|partial)")
_FRAME = re.compile(rf"{re.escape(FRAMES)}/\d+/(.+)")
_PARTIAL = re.compile(r"\.([^/.]+)\.partial-\d+(\.\w+)$")


def is_dataset_file(name: str) -> bool:
    """Whether ``simulate`` writes a file of this name, relative to the dataset, with "/"."""
    return name == SCENE_FILE or _DATASET.fullmatch(name) is not None


def is_staged_file(name: str) -> bool:
    """The same for the hidden folder of a dataset on its way."""
    frame = _FRAME.fullmatch(name)
    if frame is not None:
        whole = _PARTIAL.sub(r"\1\2", frame[1])
        return is_dataset_file(f"mav0/{whole}")
    return is_dataset_file(name) or _STAGING.fullmatch(name) is not None


def is_whole(folder: Path) -> bool:
    """Whether a folder is a dataset that ``simulate`` made, with nothing else in it."""
    return why_not_ours(folder) == ""


def why_not_ours(folder: Path) -> str:
    """What speaks against a folder being a dataset of ``simulate`` and nothing else; empty: nothing does."""
    for name in (SCENE_FILE, "mav0/target0/target.yaml"):
        if not ((folder / name).is_file() and is_regular(folder / name)):
            return f"it has no {name}"
    others = foreign(folder, is_dataset_file)
    if others:
        return f"it holds {others[0]}"
    try:
        config = load_config(folder / SCENE_FILE)
    except InputError:
        return f"its {SCENE_FILE} cannot be read"
    if config.scene is None:
        return f"its {SCENE_FILE} has no scene"
    known = {int(stamp) for stamp in timestamps(config.scene)}
    not_asked_for = {name for name, is_written in _on_request(config.scene).items() if not is_written}
    for path in sorted((folder / "mav0").rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name.split("/")[1] in not_asked_for:
            return f"its {SCENE_FILE} does not ask for {name}"
        stamped = _STAMPED.fullmatch(name)
        if stamped and int(stamped[1]) not in known:
            return f"its {SCENE_FILE} is of other images than {name}"
    return ""


def _on_request(scene: Scene) -> dict[str, bool]:
    """Folders that not every scene has, and whether this one has them."""
    return {
        "masks0": scene.render.masks,
        "masks1": scene.render.masks and scene.ranges is None,
        "truth0": bool(scene.render.products),
        "truth1": bool(scene.render.products) and scene.ranges is None,
        "cam1": scene.ranges is None,
        "range0": scene.ranges is not None,
        "inspector0": scene.inspector.moves and scene.inspector.reported,
        "wrench0": bool(scene.motion.pushes) and scene.motion.pushes_known,
    }
