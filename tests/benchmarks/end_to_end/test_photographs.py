"""What the share of vertices outside of a known box depends on."""

from types import SimpleNamespace
from typing import cast

import numpy as np

from benchmarks.end_to_end.photographs import limits_of_the_box
from polhode.lie import exp_so3, make_pose
from polhode.pipeline.run_directory.stored_run import StoredRun


def test_vertices_outside_are_told_by_their_frames_sigmas_and_by_a_shift() -> None:
    X_CO = make_pose(exp_so3(np.outer(np.arange(3.0), [0.0, 0.1, 0.0])), np.array([0.0, 0.0, 1.0]))
    stamps = np.arange(3)
    # two of eight vertices are 0.1 mm and 1 mm beyond the upper face; the far one was seen in three frames
    z = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.0501, 0.051])
    content = SimpleNamespace(
        motion=SimpleNamespace(trajectory=SimpleNamespace(timestamps_ns=stamps), X_NG=X_CO),
        landmarks=SimpleNamespace(p_G=np.random.default_rng(2).uniform(-0.05, 0.05, (20, 3))),
        surface=SimpleNamespace(
            mesh=SimpleNamespace(vertices=np.column_stack([np.zeros(8), np.zeros(8), z])),
            views=np.array([9, 9, 9, 9, 9, 9, 9, 3]),
            sigma_m=np.full(8, 0.4e-3),
        ),
    )
    box = np.array([[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05 + 1e-9]])
    seen, _, beyond, moved = limits_of_the_box(cast(StoredRun, content), stamps, X_CO, box)
    assert "4: 14.29 % (88% left)" in seen
    assert beyond.endswith("1: 12.50 %, 2: 12.50 %, 3: 0.00 %")
    assert moved.endswith("12.50 to 37.50 %")
