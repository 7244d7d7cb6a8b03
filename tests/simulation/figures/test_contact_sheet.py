"""The contact sheet shows the lit part of frames over the whole sequence."""

from pathlib import Path

import numpy as np

from polhode.config.scene import Scene
from polhode.progress import Silent
from polhode.simulation.dataset.sequence import simulate
from polhode.simulation.figures.contact_sheet import contact_sheet


def test_every_tile_of_the_sheet_shows_the_target(tmp_path: Path) -> None:
    rig = {"width_px": 96, "height_px": 72, "focal_px": 70.0}
    motion = {"position_m": [0.04, 0.0, 0.6], "spin_rpm": [1.0, 9.0, 0.0]}
    plain = {"light": {"earth": 0.0}, "render": {"bounces": 0}}
    scene = Scene.model_validate({"frames": 6, "rig": rig, "motion": motion, **plain})
    simulate(scene, 4, tmp_path / "S", Silent())
    sheet = contact_sheet(tmp_path / "S", columns=3, rows=2, width_px=60)
    assert sheet.shape[1] == 180
    tiles = [tile for row in np.split(sheet, 2) for tile in np.split(row, 3, axis=1)]
    assert all(np.mean(tile > 20) > 0.2 for tile in tiles)
    assert not np.array_equal(tiles[0], tiles[5])
