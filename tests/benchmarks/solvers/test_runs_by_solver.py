"""Both solvers and the default on a stored run: rows of what they did; a run without a motion has its row."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.solvers.runs_by_solver import main, solve_run
from polhode.pipeline.run_directory.archives import write_measurements
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(
    frames=12, landmarks=150, detection=0.5, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9])
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run leaves of a small sequence."""
    folder, sequence = tmp_path_factory.mktemp("run"), generate(SCENE, 2)
    write_measurements(sequence.tracks, folder / "measurements.npz", sequence.relative)
    (folder / "config.yaml").write_text("backend: {solver: ipopt}\n")
    return folder


def test_the_solvers_and_the_default_start_from_one_place_and_agree(run: Path) -> None:
    data, found = solve_run(run)
    assert data.n_frames == SCENE.frames
    assert [one.name for one in found] == ["gauss_newton", "ipopt", "ipopt"]
    assert found[2].program is not None and 1 <= found[2].program.iterations <= 3
    for one in found:
        assert one.converged and abs(one.to_gain) < 1e-5 and one.r_N.shape == (SCENE.frames, 3)
        assert one.cost == pytest.approx(found[0].cost, rel=1e-6)


def test_a_run_that_cannot_be_solved_costs_its_row_only(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence = generate(replace(SCENE, frames=4), 2)
    write_measurements(sequence.tracks, tmp_path / "measurements.npz")
    (tmp_path / "config.yaml").write_text("{}\n")
    main((tmp_path, run))
    printed = capsys.readouterr().out
    assert "no relative poses are stored" in printed
    rows = [line for line in printed.splitlines() if line.startswith("|")]
    assert len({row.count("|") for row in rows}) == 1 and len(rows) == 4
    assert "1 runs; Gauss-Newton alone ends more than 1e-06 above IPOPT in 0," in printed
