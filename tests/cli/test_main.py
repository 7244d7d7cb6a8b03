"""The program as a user meets it: exit codes, one line on standard error, help, the last line."""

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polhode.pipeline.run
from polhode.cli.evaluate import EvaluateCommand
from polhode.cli.import_sequence import ImportCommand
from polhode.cli.main import COMMANDS, main
from polhode.cli.options import ConfiguredCommand, GeneralOptions, all_settings, options_of
from polhode.cli.parsing import parse
from polhode.cli.plan import PlanCommand
from polhode.cli.run import RunCommand
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.records.dataset_writer import write_png
from polhode.run_directory.outputs import write_config
from polhode.run_directory.summary import build_summary, write_summary
from polhode.runtime.errors import RunFailure

Capture = pytest.CaptureFixture[str]
ROOT = Path(__file__).parents[2]


def error_line(arguments: list[str], capsys: Capture, code: int = 2) -> str:
    """Run; check the exit code and that standard error is exactly one line; return it."""
    assert main(arguments) == code
    stderr = capsys.readouterr().err
    assert stderr.startswith("polhode: error: ") and stderr.endswith("\n") and stderr.count("\n") == 1
    return stderr


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text("seed: 1\n")
    return path


def run_arguments(config: Path, data: Path, output: Path, *more: str) -> list[str]:
    return ["run", str(config), "--data", str(data), "-o", str(output), *more]


EXPECT = "expect --size 3 --range 10 --focal-px 9 --baseline 1"
BAD_USAGE = {
    "": "a command is missing: simulate, import, calibrate, checkout, run",
    "rnu": "unknown command 'rnu'; did you mean run?",
    "run": "-o RUN (folder of the results, which is created) is missing",
    "run -o R": "the sequence is missing: give --data SEQ, or --live SOURCE",
    "run --data S --live S -o R": "--data and --live: give one",
    "run --data S --rate 1 -o R": "--rate and --patience-s need --live",
    "run --live S --rate=-1 -o R": "--rate -1: give 1 for the sequence's",
    "run --live S --patience-s 0 -o R": "--patience-s 0: give seconds",
    "run --live none -o R": "none: no such sequence: give the folder",
    "predict": "RUN (folder of a finished run) and --horizon S (time to predict beyond ",
    "run c.yaml --data": "--data: a value is missing; give SEQ;",
    "plan R -o D --dock-point 1 2": "--dock-point 1 2: give 3 numbers: X Y Z, each from",
    "plan R -o D --dock-axis -1 0 0 0": "--dock-axis -1 0 0 0: give 3 numbers: X Y Z;",
    "plan R -o D --dock-point=x": "--dock-point x: give 3 numbers: X Y Z",
    "plan R -o D --members 1.5": "--members 1.5: give a whole number from 60 to 100000;",
    "predict R --horizon-s soon": "--horizon-s soon: give a number;",
    "plan R -o D --cover x": "--cover x: give one of auto, possible, outlines, surface, hull;",
    "run --data S -o R --overwite": "unknown option '--overwite'; did you mean --overwrite?",
    "checkout --rg R S -o D": "did you mean --rig?",
    "calibrate --boards 9x6 -o R": "unknown option '--boards'; did you mean --board?",
    "import a.bag -o S --xyz 3": "'--xyz'; see polhode import",
    "run c.yaml --data S -o R --bakend.inertia x": "'--bakend.inertia'; did you mean --backend.inertia?",
    "evaluate R S T": "unexpected argument 'T'",
    "run c.yaml --data S -o R --seed": "--seed: a value is missing",
    "run --seed -o x": "--seed: a value is missing",
    f"{EXPECT} --rpm 0": "--rpm 0: give a number from 1e-12 to 1e+12;",
    f"{EXPECT} --rpm nan": "--rpm nan: give a number from 1e-12 to 1e+12;",
    f"{EXPECT} --rpm 1 --sun-angle 181": "--sun-angle 181: give a number from 0 to 180;",
    "plan R -o D --dock-axis 0 0 1 --dock-point 1 2 1e9": "1e9: give 3 numbers: X Y Z, each from -1e+06 to",
    "evaluate R S --seed 1": "'evaluate' reads no configuration",
    "run c.yaml --data '' -o R": "--data: an empty value was given",
    "run --data S --output=": "--output: an empty value was given",
    "evaluate R ''": "polhode evaluate: an empty value was given",
    "run c.yaml --data S -o R": "c.yaml is missing",
    "run -o R --scene.motion.spin-rpm '[1'": "--scene.motion.spin_rpm: the brackets of '[1' do not match",
}  # fmt: skip


@pytest.mark.parametrize("words", BAD_USAGE)
def test_bad_usage_is_one_line_and_exit_2(words: str, capsys: Capture) -> None:
    assert BAD_USAGE[words] in error_line(shlex.split(words), capsys)


OVERRIDES: dict[str, dict[str, Any]] = {
    "c.yaml --data S": {},
    "--seed 3 c.yaml": {"seed": "3"},
    "--seed=3 c.yaml": {"seed": "3"},
    "--backend.accel-psd 1e-8": {"backend.accel_psd": "1e-8"},
    "--backend.accel_psd 1e-8": {"backend.accel_psd": "1e-8"},
    "--mapping.voxel-mm None": {"mapping.voxel_mm": None},
    "--scene.motion.spin-rpm -0.5 10 -.5": {"scene.motion.spin_rpm": ["-0.5", "10", "-.5"]},
    "--scene.motion.spin-rpm '[1, 2, 3]' c.yaml": {"scene.motion.spin_rpm": ["1", "2", "3"]},
    "--scene.motion.spin-rpm=1,2,3": {"scene.motion.spin_rpm": ["1", "2", "3"]},
    "--scene.mass.inertia-kg-m2 1 2 3 4 5 6 7 8 9": {
        "scene.mass.inertia_kg_m2": [["1", "2", "3"], ["4", "5", "6"], ["7", "8", "9"]]
    },
    "--scene.inspector.waypoints '[{time_s: 1}]'": {"scene.inspector.waypoints": [{"time_s": 1}]},
    "--backend.unknown 1 --seed 2": {"backend.unknown": "1", "seed": "2"},
    # a mistyped key takes its values along
    "--scene.motion.spin_rmp 0 8 0": {"scene.motion.spin_rmp": ["0", "8", "0"]},
}


@pytest.mark.parametrize("words", OVERRIDES)
def test_keys_of_the_configuration_are_told_from_options_and_arguments(words: str) -> None:
    command, found = parse("run", RunCommand, [*shlex.split(words), "-o", "R"])
    assert (found, command.output) == (OVERRIDES[words], Path("R"))
    assert command.config == (Path("c.yaml") if "c.yaml" in words else None)


def test_options_are_converted_to_their_types() -> None:
    plan, _ = parse("plan", PlanCommand, ["-oD", "--dock-axis", "-1", "0", "1e3", "R", "--members=70"])
    assert (plan.run, plan.output, plan.members) == (Path("R"), Path("D"), 70)
    assert plan.dock_axis == (-1.0, 0.0, 1000.0) and plan.dock_point is None
    words = ["a.bag", "--stamps", "l.csv", "r.csv", "--start", "2", "-o", "S", "--overwrite"]
    imported, _ = parse("import", ImportCommand, words)
    assert (imported.sources, imported.stamps) == ((Path("a.bag"),), (Path("l.csv"), Path("r.csv")))
    assert (imported.start_s, imported.overwrite, imported.rate_hz) == (2.0, True, None)
    assert parse("evaluate", EvaluateCommand, ["--", "-a", "-b"])[0].data == Path("-b")


def test_a_bad_configuration_is_one_line_and_exit_2(config: Path, tmp_path: Path, capsys: Capture) -> None:
    arguments = run_arguments(config, tmp_path, tmp_path / "run")
    config.write_text("backend: {inerta: ratios_axes}\n")
    assert f"{config}: unknown key 'backend.inerta'; did you mean inertia?" in error_line(arguments, capsys)
    config.write_text("")
    for words, said in (
        ("--backend.accel-psd small", "'backend.accel_psd': expected a number, got text 'small'"),
        ("--backend.accel-psd 1e308", "'backend.accel_psd': must be at most"),
        ("--runtime.workers -1", "'runtime.workers': must be at least 0, got"),
    ):
        assert f"command line: key {said}" in error_line([*arguments, *words.split()], capsys)
    simulation = ["simulate", str(config), "-o", str(tmp_path / "s")]
    assert "no 'scene' to simulate" in error_line(simulation, capsys)


@dataclass(frozen=True)
class Result:
    status: str
    report_path: Path
    sentence: str = "Found it."
    failure: str | None = None
    note: str = ""


def truncated(folder: Path) -> None:
    for path in sorted(folder.glob("mav0/cam0/data/*.png"))[:4]:
        path.write_bytes(path.read_bytes()[:500])


def black(folder: Path) -> None:
    for path in folder.glob("mav0/cam*/data/*.png"):
        write_png(path, np.zeros((48, 64), dtype=np.uint8))


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (truncated, "4 of 6 frames are missing, unpaired or unreadable"),
        (black, "all frames are black"),
        (lambda folder: folder.rename(folder.with_name("gone")), "is not a folder"),
    ],
)
def test_bad_data_is_one_line_exit_2_and_leaves_nothing(
    damage: Callable[[Path], None], expected: str, small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    damage(small_sequence)
    before = sorted(tmp_path.iterdir())
    line = error_line(["run", "--data", str(small_sequence), "-o", str(tmp_path / "run")], capsys)
    assert expected in line and str(small_sequence) in line
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_a_run_that_exists_is_refused_or_stays_whole_when_the_new_one_is_bad(
    small_sequence: Path, config: Path, tmp_path: Path, more: list[str], capsys: Capture
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write_config(run, Config())
    write_summary(build_summary(None, None, None, {}, failure="black"), run / "summary.json")
    (run / "trajectory.csv").write_text("old")
    content = {path.name: path.read_bytes() for path in run.iterdir()}
    if more:
        truncated(small_sequence)
    line = error_line(run_arguments(config, small_sequence, run, *more), capsys)
    assert ("--overwrite" in line) != bool(more)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == content


def test_the_last_line_of_a_run_ends_with_the_report_however_long(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    report = tmp_path / ("long name " * 20) / "report.html"
    seen: list[Config] = []
    for status, code in (("ok", 0), ("degraded", 0), ("failed", 1)):
        result = Result(status, report, failure="the solver stopped" if code else None)

        def fake(values: Config, *_: Any, result: Result = result, **__: Any) -> Result:
            seen.append(values)
            return result

        monkeypatch.setattr(polhode.pipeline.run, "run", fake)
        words = run_arguments(config, tmp_path, tmp_path / "run", "--backend.inertia", "ratios_axes")
        assert main(words) == code
        assert capsys.readouterr().out.splitlines()[-2:] == ["Found it.", f"Report: {report}"]
        assert main(["run", "--data", str(tmp_path), "-o", str(tmp_path / "run")]) == code
    assert (seen[0].seed, seen[0].backend.inertia) == (1, "ratios_axes")
    assert seen[1] == load_config(ROOT / "configs" / "default.yaml") == Config()


def test_a_failed_run_lists_its_warnings_and_one_that_raises_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    report = tmp_path / "report.html"

    def fake(*arguments: Any, **more: Any) -> Result:
        warnings = ["3 frames are lost", "a line\nbreaks"]
        summary = build_summary(None, None, None, {}, warnings, failure="no motion")
        write_summary(summary, tmp_path / "summary.json")
        return Result("failed", report, failure="no motion")

    monkeypatch.setattr(polhode.pipeline.run, "run", fake)
    words = ["run", "--data", str(tmp_path), "-o", str(tmp_path)]
    assert main(words) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "Warnings of this run:" and lines[-1].endswith(str(report))
    assert lines[1:-1] == ["- 3 frames are lost", "- a line breaks", "Found it."]
    assert main([*words, "--quiet"]) == 1
    assert capsys.readouterr().out == f"Report: {report}\n"

    def fail(*arguments: Any, **more: Any) -> None:
        raise RunFailure("no motion fits")

    monkeypatch.setattr(polhode.pipeline.run, "run", fail)
    assert "no motion fits" in error_line(words, capsys, code=1)


def test_an_unexpected_error_shows_its_traceback_only_with_debug(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def fail(command: EvaluateCommand) -> None:
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr(EvaluateCommand, "execute", fail)
    assert "ZeroDivisionError: a b" in error_line(["evaluate", "R", "S"], capsys, code=1)
    assert main(["--debug", "evaluate", "R", "S"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("columns", [60, 120])
@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_every_option_within_the_width_of_the_terminal(
    name: str, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main([name, "-h"]) == main([name, "--help", "--wrong"]) == 0
    short, everything = capsys.readouterr().out.split(f"usage: polhode {name}")[1:]
    command = COMMANDS[name]
    names = [*options_of(command).values(), *options_of(GeneralOptions).values()]
    for option in names:
        shown = option.metavar if option.is_positional else min(option.names, key=len)
        assert re.search(rf"\n  {re.escape(shown)}(?:[ ,][^\n]*)?\n      \S", short), option
        assert option.invocation in " ".join(short.partition("\n\n")[0].split()) or not option.required
    # only a word or an option may be longer than the terminal is wide
    long = [line for line in short.splitlines()[1:] if len(line) > columns]
    assert all(line.startswith("  -") or len(line.split()) == 1 for line in long)
    left_out = {"simulate": "--train", "train": "--scene"}.get(name, ("--train", "--scene"))
    missing = [each.names[0] for each in all_settings() if f"\n  {each.names[0]} " not in everything]
    if issubclass(command, ConfiguredCommand):
        assert all(each.startswith(left_out) for each in missing) and "(default: 1e-06)" in everything
    else:
        assert everything == short


def test_the_overview_has_every_command_once_and_its_summary_is_a_sentence(capsys: Capture) -> None:
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    named = [line.split()[0] for line in lines if re.match(r"  [a-z]+  ", line)]
    assert sorted(named) == sorted(COMMANDS)
    for command in COMMANDS.values():
        assert (command.__doc__ or "").partition("\n")[0].rstrip().endswith(".")


def test_the_program_itself_imports_nothing_heavy_for_help_and_exits_with_the_code() -> None:
    heavy = "numpy scipy torch cv2 casadi numba kornia trimesh plotly skimage"
    code = (
        "import sys; from polhode.cli.main import main; assert main(['run', '--help']) == 0;"
        f"assert not set('{heavy}'.split()) & set(sys.modules), sys.modules.keys()"
    )
    for words, expected in (
        (["-c", code], (0, "")),
        (
            ["-m", "polhode", "run", "none.yaml", "--data", "S", "-o", "R"],
            (2, "polhode: error: none.yaml is missing: give an existing configuration file\n"),
        ),
    ):
        done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == expected
    assert done.stdout == ""
