"""NaN and repeated times in the files that commands read: exit code 2, one line that names the file."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.config import Config
from polhode.records.dataset_writer import write_inspector, write_truth, write_wrench
from polhode.records.estimate import OnlineEstimate
from polhode.records.truth import Truth
from polhode.run_directory.outputs import write_online_estimate
from polhode.run_directory.summary import read_summary, with_files, write_summary
from tests.conftest import TIMESTAMPS_NS
from tests.pipeline.conftest import Example
from tests.pipeline.stored_run import write_run

Capture = pytest.CaptureFixture[str]
Damage = Callable[[Path], None]


def refused(arguments: list[str], file: Path, words: str, capsys: Capture) -> None:
    """Exit code 2 and exactly one line on standard error, with the file and the words."""
    code = main(arguments)
    stderr = capsys.readouterr().err
    assert code == 2, stderr
    assert stderr.startswith("polhode: error: ") and stderr.count("\n") == 1
    assert str(file) in stderr and words in stderr, stderr


def text(old: str, new: str) -> Damage:
    """Replace the first occurrence."""

    def damage(file: Path) -> None:
        content = file.read_text()
        assert old in content
        file.write_text(content.replace(old, new, 1))

    return damage


def cell(row: int, column: int, value: str) -> Damage:
    """Put a value into a row of numbers below the header."""

    def damage(file: Path) -> None:
        lines = file.read_text().splitlines()
        cells = lines[1 + row].split(",")
        cells[column] = value
        lines[1 + row] = ",".join(cells)
        file.write_text("\n".join(lines) + "\n")

    return damage


def repeated(file: Path) -> None:
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:3], lines[2], *lines[3:]]) + "\n")


def shortened(file: Path) -> None:
    file.write_text("\n".join(file.read_text().splitlines()[:4]))


def array(name: str, value: float) -> Damage:
    """Put a value into an array of an archive."""

    def damage(file: Path) -> None:
        with np.load(file) as archive:
            arrays = dict(archive)
        spoilt = arrays[name].astype(float)
        spoilt.flat[0] = value
        np.savez(file, **{**arrays, name: spoilt})

    return damage


def point(file: Path) -> None:
    """NaN as the first coordinate of a cloud or a mesh."""
    head, mark, body = file.read_bytes().partition(b"end_header\n")
    nan = np.array([np.nan], dtype="<f8" if b"property double x" in head else "<f4").tobytes()
    file.write_bytes(head + mark + nan + body[len(nan) :])


IN_SEQUENCE: tuple[tuple[str, Damage, str], ...] = (
    ("cam0/data.csv", repeated, "line 4: timestamp 1600000000500000000 repeats"),
    ("cam1/data.csv", repeated, "repeats"),
    ("inspector0/data.csv", repeated, "repeats"),
    ("wrench0/data.csv", repeated, "repeats"),
    ("cam1/data.csv", cell(1, 0, "nan"), "line 3: timestamp 'nan'"),
    ("inspector0/data.csv", cell(1, 2, "nan"), "line 3: NaN or infinity"),
    ("inspector0/data.csv", cell(1, 4, "NaN"), "line 3: NaN or infinity"),
    ("wrench0/data.csv", cell(1, 1, "nan"), "line 3: NaN or infinity"),
    ("wrench0/data.csv", cell(0, 6, "-inf"), "line 2: NaN or infinity"),
    ("cam0/sensor.yaml", text("[50.0", "[.nan"), "'intrinsics': contains NaN"),
    ("cam1/sensor.yaml", text("0.09", ".nan"), "'T_BS': contains NaN"),
    ("cam1/sensor.yaml", text("-0.1", ".nan"), "'distortion_coefficients': contains NaN"),
    ("cam0/sensor.yaml", text("[64,", "[.nan,"), "'resolution': contains NaN"),
    ("cam0/sensor.yaml", text("rate_hz", "bits: .nan\nrate_hz"), "'bits'"),
    ("inspector0/sensor.yaml", text("0.001", ".nan"), "'sigma_p_m': contains NaN"),
)


@pytest.mark.parametrize(("where", "damage", "words"), IN_SEQUENCE)
def test_a_table_or_calibration_is_refused_and_nothing_is_written(
    small_sequence: Path, tmp_path: Path, capsys: Capture, where: str, damage: Damage, words: str
) -> None:
    mav0, n = small_sequence / "mav0", len(TIMESTAMPS_NS)
    write_inspector(mav0, TIMESTAMPS_NS, np.tile(np.eye(4), (n, 1, 1)), sigma_p_m=0.001)
    write_wrench(mav0, TIMESTAMPS_NS, np.zeros((n, 3)), np.zeros((n, 3)))
    damage(mav0 / where)
    arguments = ["run", "configs/default.yaml", "--data", str(small_sequence), "-o", str(tmp_path / "run")]
    refused(arguments, mav0 / where, words, capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["sequence"]


@pytest.mark.parametrize(
    ("content", "key"),
    [
        ("backend: {accel_psd: .nan}", "backend.accel_psd"),
        ("backend: {unknown_wrench_s: [[.nan, 1.0]]}", "backend.unknown_wrench_s"),
        ("backend: {max_seconds: .inf}", "backend.max_seconds"),
    ],
)
def test_a_configuration_is_refused(tmp_path: Path, capsys: Capture, content: str, key: str) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(content + "\n")
    arguments = ["run", str(config), "--data", str(tmp_path), "-o", str(tmp_path / "run")]
    refused(arguments, config, key, capsys)
    assert not (tmp_path / "run").exists()


REPORT, PREDICT, EVALUATE = "report", "predict", "evaluate"
ALL, TABLES, NAN = (REPORT, PREDICT, EVALUATE), "run/measurements.npz", "NaN or infin"
TRUTH = "sequence/mav0/target0"
STORED: tuple[tuple[str, Damage, str, tuple[str, ...]], ...] = (
    (TABLES, array("uvd_px", np.nan), f"uvd_px holds {NAN}", (REPORT,)),
    (TABLES, array("sigma_px", np.inf), f"sigma_px holds {NAN}", (REPORT,)),
    (TABLES, array("X_NR", np.nan), f"X_NR holds {NAN}", (REPORT,)),
    (TABLES, array("X_BR", np.nan), f"X_BR holds {NAN}", (REPORT,)),
    (TABLES, array("rig_focal_px", np.nan), f"rig_focal_px holds {NAN}", (REPORT,)),
    (TABLES, array("frame", np.nan), "frame holds float64", (REPORT,)),
    (TABLES, array("residuals_px", np.nan), f"residuals_px holds {NAN}", (REPORT,)),
    ("run/trajectory.csv", cell(3, 1, "nan"), "line 5: a state that is NaN", ALL),
    ("run/trajectory.csv", cell(3, -1, "nan"), "line 5: a standard deviation", ALL),
    ("run/trajectory.csv", cell(3, 0, "nan"), "timestamp 'nan' is not a whole number", ALL),
    ("run/trajectory.csv", shortened, "trajectory.csv: not the file that this run wrote", ALL),
    ("run/covariance.npz", array("covariance", np.nan), "holds NaN", ALL),
    ("run/covariance.npz", array("last_body", np.inf), "last_body holds NaN", (REPORT, PREDICT)),
    ("run/summary.json", text('"k1": ', '"k1": NaN, "_": '), "NaN is no number of JSON", ALL),
    ("run/online.npz", array("r_N", np.nan), "r_N holds NaN in row 0", (REPORT,)),
    ("run/landmarks.ply", point, "NaN or infinity in point 0", (REPORT,)),
    ("run/mesh.ply", point, "NaN or infinite", (REPORT, EVALUATE)),
    ("run/config.yaml", text("accel_psd: ", "accel_psd: .nan #"), "accel_psd", (PREDICT, EVALUATE)),
    (f"{TRUTH}/data.csv", cell(2, 1, "nan"), "line 4: NaN or infinity", (EVALUATE,)),
    (f"{TRUTH}/data.csv", repeated, "repeats", (EVALUATE,)),
    (f"{TRUTH}/target.yaml", text("k1: ", "k1: .nan #"), "'k1': contains NaN", (EVALUATE,)),
    (f"{TRUTH}/mesh.ply", point, "contains NaN or infinity", (EVALUATE,)),
)


@pytest.fixture(scope="module")
def run_and_truth(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """run/ and sequence/ with the truth alone, which is the estimate."""
    folder = tmp_path_factory.mktemp("stored")
    (folder / "run").mkdir()
    motion, mass = example.estimate, example.estimate.mass
    write_run(
        folder / "run", config=Config(), tracks=example.tracks, estimate=motion, surface=example.surface,
        timing_s={}, relative=example.relative,
    )  # fmt: skip
    n = len(motion.timestamps_ns)
    eye, two = np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(2), (n, 1, 1))
    online = OnlineEstimate(
        motion.timestamps_ns, motion.r_N, motion.v_N, motion.R_NP, motion.w_P, motion.covariance, motion.X_NG,
        k=np.zeros((n, 2)), cov_k=two, com_G=np.zeros((n, 3)), cov_com_G=eye, R_GP=eye, cov_R_GP=eye,
        determined=np.ones((n, 4), dtype=np.bool_), frame=np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    write_online_estimate(folder / "run", online)
    summary = folder / "run" / "summary.json"
    write_summary(with_files(read_summary(summary), folder / "run"), summary)
    truth = Truth(
        motion.timestamps_ns, motion.r_N, motion.R_NP, motion.v_N, motion.w_P,
        mass.moments, mass.k1, mass.k2, mass.com_G, mass.R_GP, example.surface.mesh,
    )  # fmt: skip
    write_truth(folder / "sequence" / "mav0", truth)
    return folder


@pytest.mark.parametrize(("where", "damage", "words", "commands"), STORED)
def test_a_file_of_a_run_or_of_the_truth_is_refused_by_every_command_that_reads_it(
    run_and_truth: Path, tmp_path: Path, capsys: Capture, where: str, damage: Damage, words: str,
    commands: tuple[str, ...],
) -> None:  # fmt: skip
    shutil.copytree(run_and_truth, tmp_path, dirs_exist_ok=True)
    damage(tmp_path / where)
    run = str(tmp_path / "run")
    lines = {
        REPORT: ["report", run, "-o", str(tmp_path / "page.html")],
        PREDICT: ["predict", run, "--horizon", "5", "-o", str(tmp_path / "ahead.csv")],
        EVALUATE: ["evaluate", run, str(tmp_path / "sequence")],
    }
    for each in commands:
        refused(lines[each], tmp_path / where, words, capsys)
    made = ("page.html", "ahead.csv", "run/metrics.json")
    assert not any((tmp_path / file).exists() for file in made)
