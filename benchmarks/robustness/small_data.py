"""The small sequence of the benchmarks about kills and leaks: eight pairs of 200 x 160 px."""

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


def write_scene(path: Path) -> Path:
    """The configuration of the scene."""
    path.write_text(SCENE, encoding="utf-8")
    return path


def write_sequence(folder: Path) -> Path:
    """Render the scene."""
    import yaml

    from polhode.config import Config
    from polhode.progress import Silent
    from polhode.simulation import simulate

    config = Config.model_validate(yaml.safe_load(SCENE))
    assert config.scene is not None
    simulate(config.scene, config.seed, folder, Silent())
    return folder
