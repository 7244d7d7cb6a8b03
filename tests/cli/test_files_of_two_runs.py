"""Files of two runs in one folder: numbers are refused by every command, other files give a warning."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.cli.main import main
from tests.conftest import MakeOnce
from tests.pipeline.conftest import Example, make_example, write_example

Capture = pytest.CaptureFixture[str]
COMMANDS: dict[str, list[str]] = {
    "predict": ["predict", "RUN", "--horizon", "5", "-o", "OUT.csv"],
    "report": ["report", "RUN", "-o", "OUT.html"],
    "export": ["export", "RUN", "--to", "json", "-o", "OUT.json"],
    "export of a mesh": ["export", "RUN", "--to", "ply", "-o", "OUT.ply"],
    "plan": ["plan", "RUN", "-o", "OUT"],
    "observability": ["observability", "RUN", "-o", "OUT"],
    "evaluate": ["evaluate", "RUN", "SEQ"],
    "compare": ["compare", "--run", "RUN", "-o", "OUT"],
}


def _like(example: Example) -> Example:
    """Another target at the same instants."""
    estimate, tracks = example.estimate, example.tracks
    mass = replace(estimate.mass, com_G=estimate.mass.com_G + 0.01)
    surface = replace(example.surface, sigma_m=2.0 * example.surface.sigma_m)
    landmarks = replace(estimate.landmarks, p_G=1.1 * estimate.landmarks.p_G)
    found = replace(
        estimate, r_N=1.1 * estimate.r_N, covariance=4.0 * estimate.covariance, mass=mass, landmarks=landmarks
    )
    return replace(
        example, tracks=replace(tracks, uvd_px=tracks.uvd_px + 1.0), estimate=found, surface=surface
    )


@pytest.fixture(scope="module")
def two_runs(make_once: MakeOnce) -> Path:
    """``one`` and ``other``, whose frames have the same timestamps."""

    def fill(folder: Path) -> None:
        for name, example in (("one", make_example()), ("other", _like(make_example()))):
            (folder / name).mkdir(parents=True)
            write_example(folder / name, example)

    return make_once("two_runs", fill)


@pytest.fixture
def run(two_runs: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(two_runs / "one", tmp_path / "run"))


def _words(command: str, run: Path) -> list[str]:
    places = {"RUN": str(run), "SEQ": str(run.parent)}
    out = str(run.with_name("out"))
    return [places.get(word, word.replace("OUT", out)) for word in COMMANDS[command]]


@pytest.mark.parametrize(
    ("file", "command"),
    [
        *(("measurements.npz", command) for command in COMMANDS),
        *((file, "predict") for file in ("summary.json", "trajectory.csv", "covariance.npz")),
    ],
)
def test_numbers_of_another_run_are_refused(
    file: str, command: str, run: Path, two_runs: Path, capsys: Capture
) -> None:
    shutil.copy(two_runs / "other" / file, run / file)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert main(_words(command, run)) == 2
    line = capsys.readouterr().err
    assert line.startswith("polhode: error: ") and line.count("\n") == 1
    named = "trajectory.csv" if file == "summary.json" else file
    assert str(run / named) in line and "not the file that this run wrote" in line
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    made = {path.name for path in run.parent.iterdir()} - {"run"}
    # A comparison claims its folder before it reads the run.
    assert made <= ({"out"} if command == "compare" else set())


def test_what_users_may_edit_gives_one_warning_and_what_was_written_none(
    run: Path, two_runs: Path, capsys: Capture
) -> None:
    for command in ("predict", "report", "export"):
        assert main(_words(command, run)) == 0
        assert "this run wrote" not in capsys.readouterr().out
    for file in ("mesh.ply", "landmarks.ply", "config.yaml"):
        before = (run / file).read_bytes()
        other = (two_runs / "other" / file).read_bytes()
        (run / file).write_bytes(before + b"# mine\n" if file == "config.yaml" else other)
        assert main(_words("export", run)) == 0
        shown = capsys.readouterr().out
        assert shown.count(f"{run / file}: not the file that this run wrote") == 1
        (run / file).write_bytes(before)
    # only the numbers that are there are compared
    (run / "pushes.csv").write_text("mine\n")
    (run / "measurements.npz").unlink()
    assert main(_words("predict", run)) == 0


def test_a_causal_estimate_that_the_run_did_not_write_is_refused(run: Path, capsys: Capture) -> None:
    with np.load(run / "covariance.npz") as archive:
        stamps = archive["timestamps_ns"]
    n = len(stamps)
    eye, rows = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    np.savez(
        run / "online.npz", timestamps_ns=stamps, r_N=rows, v_N=rows, R_NP=eye, w_P=rows,
        covariance=np.tile(np.eye(12), (n, 1, 1)), X_NG=np.tile(np.eye(4), (n, 1, 1)), k=rows[:, :2],
        cov_k=np.tile(np.eye(2), (n, 1, 1)), com_G=rows, cov_com_G=eye, R_GP=eye, cov_R_GP=eye,
        determined=np.ones((n, 4), dtype=np.bool_),
    )  # fmt: skip
    assert main(_words("report", run)) == 2
    assert "online.npz: not the file that this run wrote" in capsys.readouterr().err
