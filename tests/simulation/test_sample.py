"""The sample that ships is what its configuration makes, and small enough to ship."""

from pathlib import Path

import numpy as np

from polhode.config.loader import load_config
from polhode.records.dataset import open_sequence
from polhode.records.read_truth import read_truth
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.sequence import plan_sequence, simulate, truth_of

ROOT = Path(__file__).parents[2]
CONFIG = load_config(ROOT / "configs" / "sample.yaml")
SAMPLE = ROOT / "examples" / "sample"


def test_the_samples_truth_is_that_of_its_configuration() -> None:
    assert CONFIG.scene is not None
    planned, stored = truth_of(plan_sequence(CONFIG.scene, CONFIG.seed)), read_truth(SAMPLE)
    np.testing.assert_array_equal(stored.timestamps_ns, planned.timestamps_ns)
    for name in ("r_N", "v_N", "R_NP", "w_P", "moments", "com_G", "R_GP"):
        np.testing.assert_allclose(getattr(stored, name), getattr(planned, name), atol=1e-9)


def test_the_samples_images_are_those_of_its_configuration(tmp_path: Path) -> None:
    assert CONFIG.scene is not None
    simulate(CONFIG.scene.model_copy(update={"frames": 3}), CONFIG.seed, tmp_path / "S", Silent())
    stored, made = open_sequence(SAMPLE), open_sequence(tmp_path / "S")
    assert len(stored.timestamps_ns) == CONFIG.scene.frames
    for k in range(2):
        was, now = stored.read_pair(k), made.read_pair(k)
        for one, other in ((was.left, now.left), (was.right, now.right)):
            # Another processor may round a ray at an edge the other way.
            assert np.mean(np.abs(one.astype(int) - other) > 1) < 1e-3
