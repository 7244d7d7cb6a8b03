"""The scenes by group and name: those of configs/, new ones, bodies of revolution."""

from pathlib import Path

from benchmarks.command import ROOT
from benchmarks.trust.new_scenes import KINDS, new_scene
from benchmarks.trust.revolution import BODIES, body_scene
from polhode.config.loader import load_config
from polhode.config.scene_settings import Scene

CONFIGS = {
    path.stem: path for path in (ROOT / "configs/ts38.yaml", *sorted(ROOT.glob("configs/scenes/*.yaml")))
}
GROUPS: dict[str, tuple[str, ...]] = {
    "configs": tuple(CONFIGS),
    "new": tuple(KINDS),
    "revolution": BODIES,
}
"""Names of each group; those of "new" exist in any number of draws."""
SHORT: dict[str, tuple[str, ...]] = {
    "configs": ("pure_spin",),
    "new": ("lamp_alone",),
    "revolution": ("cone_rich",),
}


def scene_of(group: str, name: str, draw: int, folder: Path) -> tuple[Scene, int]:
    """A scene and its seed; the folder takes mesh files."""
    if group == "new":
        return new_scene(name, draw)
    if group == "revolution":
        return body_scene(name, folder)
    config = load_config(CONFIGS[name])
    assert config.scene is not None
    return config.scene, config.seed
