"""The small data of the benchmarks about kills and leaks: eight pairs of 200 x 160 px, eight of a board."""

from pathlib import Path

SCENE = """
seed: 3
scene:
  frames: 8
  interval_s: 0.5
  body: {family: free_flyer, size_m: 0.22}
  motion: {position_m: [0.04, 0.0, 0.5], spin_rpm: [3.0, 9.0, 2.0], spin_axes: principal}
  rig: {width_px: 200, height_px: 160, focal_px: 180.0, baseline_m: 0.09}
  truth_horizon_s: 2.0
  render: {samples: 4, bounces: 0}
runtime: {workers: 2}
"""


def write_sequence(folder: Path) -> Path:
    """Render the scene."""
    import yaml

    from polhode.config import Config
    from polhode.runtime.progress import Silent
    from polhode.simulation import simulate

    config = Config.model_validate(yaml.safe_load(SCENE))
    assert config.scene is not None
    simulate(config.scene, config.seed, folder, Silent())
    return folder


def write_boards(folder: Path) -> Path:
    """Render a chessboard of 7 x 5 inner corners, its squares 30 mm wide, into ``left/`` and ``right/``."""
    import numpy as np

    from polhode.calibration.boards import make_board
    from polhode.calibration.lenses import Lens
    from polhode.geometry.lie import exp_so3, make_pose
    from polhode.records.dataset_writer import write_png
    from tests.calibration.board_images import BoardCamera, printed

    board, rng, size = make_board("chessboard", "7x5", 0.03), np.random.default_rng(3), (320, 240)
    X_10 = make_pose(exp_so3([0.01, -0.03, 0.02]), [-0.06, 0.001, -0.002])
    lens = Lens("brown5", np.array([300.0, 301.0, 162.0, 117.0, -0.2, 0.05, 0.0006, -0.0004, 0.0]))
    camera, picture = BoardCamera(lens, size), printed(board)
    middle = 0.5 * (board.points.min(axis=0) + board.points.max(axis=0))
    staged = folder.with_name(f".{folder.name}.partial")
    for number in range(8):
        R = exp_so3(rng.uniform(-0.5, 0.5, 3))
        at = np.array([0.03, 0.0, 0.42]) + rng.uniform(-1.0, 1.0, 3) * [0.04, 0.04, 0.05]
        X_0B = make_pose(R, at - R @ middle)
        for side, X_CB in (("left", X_0B), ("right", X_10 @ X_0B)):
            write_png(staged / side / f"{number:02d}.png", camera.picture(picture, X_CB, 0.7, 1.0, rng))
    return staged.rename(folder)
