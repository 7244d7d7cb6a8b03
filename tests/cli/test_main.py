"""The program as a user meets it: exit codes, one line on standard error, help, the last line."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polhode.pipeline.run
from polhode.cli.answer import Answer
from polhode.cli.evaluate import EvaluateCommand
from polhode.cli.import_sequence import ImportCommand
from polhode.cli.main import COMMANDS, main
from polhode.cli.options import ConfiguredCommand, options_of
from polhode.cli.parsing import parse, setting_names
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
    assert stderr.startswith("polhode: error: ")
    assert stderr.endswith("\n")
    assert stderr.count("\n") == 1
    return stderr


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text("seed: 1\n")
    return path


def run_arguments(config: Path, data: Path, output: Path, *more: str) -> list[str]:
    return ["run", str(config), "--data", str(data), "-o", str(output), *more]


BAD_USAGE: dict[str, tuple[list[str], str]] = {
    "nothing": ([], "a command is missing: simulate, calibrate, checkout, run, evaluate"),
    "unknown command": (["rnu"], "unknown command 'rnu'; did you mean run?"),
    "no arguments": (["run"], "-o RUN (folder of the results, which is created) is missing"),
    "no sequence": (["run", "-o", "R"], "the sequence is missing: give --data SEQ, or --live SOURCE"),
    "two sequences": (["run", "--data", "S", "--live", "S", "-o", "R"], "--data and --live: give one"),
    "rate of a file": (
        ["run", "--data", "S", "--rate", "1", "-o", "R"],
        "--rate and --patience-s need --live",
    ),
    "negative rate": (["run", "--live", "S", "--rate=-1", "-o", "R"], "--rate -1: give 1 for the sequence's"),
    "no patience": (["run", "--live", "S", "--patience-s", "0", "-o", "R"], "--patience-s 0: give seconds"),
    "no source": (["run", "--live", "none", "-o", "R"], "none: no such sequence: give the folder"),
    "no output": (
        ["run", "c.yaml", "--data", "S"],
        "-o RUN (folder of the results, which is created) is missing",
    ),
    "nothing of what is required": (
        ["predict"],
        "RUN (folder of a finished run) and --horizon S (time to predict beyond the last stereo pair [s]) ",
    ),
    "no value": (["run", "c.yaml", "--data"], "--data: a value is missing; give SEQ;"),
    "too few values": (
        ["plan", "R", "-o", "D", "--dock-point", "1", "2"],
        "--dock-point 1 2: give 3 numbers: X Y Z, each from",
    ),
    "too many values": (
        ["plan", "R", "-o", "D", "--dock-axis", "-1", "0", "0", "0"],
        "--dock-axis -1 0 0 0: give 3 numbers: X Y Z;",
    ),
    "no numbers": (["plan", "R", "-o", "D", "--dock-point=x"], "--dock-point x: give 3 numbers: X Y Z"),
    "no whole number": (
        ["plan", "R", "-o", "D", "--members", "1.5"],
        "--members 1.5: give a whole number from 1 to 100000;",
    ),
    "no number": (["predict", "R", "--horizon-s", "soon"], "--horizon-s soon: give a number;"),
    "no such choice": (
        ["plan", "R", "-o", "D", "--cover", "x"],
        "--cover x: give one of auto, surface, hull;",
    ),
    "unknown option": (
        ["run", "c.yaml", "--data", "S", "-o", "R", "--overwite"],
        "unknown option '--overwite'; did you mean --overwrite?",
    ),
    "unknown option where the configuration is left out": (
        ["run", "--data", "S", "-o", "R", "--overwite"],
        "unknown option '--overwite'; did you mean --overwrite?",
    ),
    "unknown option before an argument": (["checkout", "--rg", "R", "S", "-o", "D"], "did you mean --rig?"),
    "unknown option beside required ones": (
        ["calibrate", "--boards", "9x6", "-o", "R"],
        "unknown option '--boards'; did you mean --board?",
    ),
    "option of no command": (["import", "a.bag", "-o", "S", "--xyz", "3"], "'--xyz'; see polhode import"),
    "unknown key": (
        ["run", "c.yaml", "--data", "S", "-o", "R", "--bakend.inertia", "x"],
        "unknown option '--bakend.inertia'; did you mean --backend.inertia?",
    ),
    "one word too many": (["evaluate", "R", "S", "T"], "unexpected argument 'T'"),
    "override without value": (
        ["run", "c.yaml", "--data", "S", "-o", "R", "--seed"],
        "--seed: a value is missing",
    ),
    "override with an option for a value": (["run", "--seed", "-o", "x"], "--seed: a value is missing"),
    "out of range": (
        ["expect", *["--size", "3", "--range", "10", "--rpm", "0", "--focal-px", "9", "--baseline", "1"]],
        "--rpm 0: give a number from 1e-12 to 1e+12;",
    ),
    "not finite": (
        ["expect", *["--size", "nan", "--range", "10", "--rpm", "1", "--focal-px", "9", "--baseline", "1"]],
        "--size nan: give a number from 1e-12 to 1e+12;",
    ),
    "share above 1": (
        [
            "expect",
            *[
                "--size",
                "3",
                "--range",
                "10",
                "--rpm",
                "1",
                "--focal-px",
                "9",
                "--baseline",
                "1",
                "--sun-angle",
                "181",
            ],
        ],
        "--sun-angle 181: give a number from 0 to 180;",
    ),
    "coordinate out of range": (
        ["plan", "R", "-o", "D", "--dock-axis", "0", "0", "1", "--dock-point", "1", "2", "1e9"],
        "--dock-point 1 2 1e9: give 3 numbers: X Y Z, each from -1e+06 to 1e+06;",
    ),
    "override of no config": (["evaluate", "R", "S", "--seed", "1"], "'evaluate' reads no configuration"),
    "an empty value": (["run", "c.yaml", "--data", "", "-o", "R"], "--data: an empty value was given"),
    "an empty value after =": (["run", "--data", "S", "--output="], "--output: an empty value was given"),
    "an empty argument": (["evaluate", "R", ""], "polhode evaluate: an empty value was given"),
    "no such config": (["run", "c.yaml", "--data", "S", "-o", "R"], "c.yaml is missing"),
}


@pytest.mark.parametrize("name", BAD_USAGE)
def test_bad_usage_is_one_line_and_exit_2(name: str, capsys: Capture) -> None:
    arguments, expected = BAD_USAGE[name]
    assert expected in error_line(arguments, capsys)


OVERRIDES: list[tuple[list[str], dict[str, Any]]] = [
    (["c.yaml", "--data", "S"], {}),
    (["--seed", "3", "c.yaml"], {"seed": "3"}),
    (["--seed=3", "c.yaml"], {"seed": "3"}),
    (["--backend.accel-psd", "1e-8"], {"backend.accel_psd": "1e-8"}),
    (["--backend.accel_psd", "1e-8"], {"backend.accel_psd": "1e-8"}),
    (["--mapping.voxel-mm", "None"], {"mapping.voxel_mm": None}),
    (["--scene.motion.spin-rpm", "-0.5", "10", "-.5"], {"scene.motion.spin_rpm": ["-0.5", "10", "-.5"]}),
    (["--scene.motion.spin-rpm", "[1, 2, 3]", "c.yaml"], {"scene.motion.spin_rpm": ["1", "2", "3"]}),
    (["--scene.motion.spin-rpm=1,2,3"], {"scene.motion.spin_rpm": ["1", "2", "3"]}),
    (
        ["--scene.mass.inertia-kg-m2", *"123456789"],
        {"scene.mass.inertia_kg_m2": [["1", "2", "3"], ["4", "5", "6"], ["7", "8", "9"]]},
    ),
    (["--scene.inspector.waypoints", "[{time_s: 1}]"], {"scene.inspector.waypoints": [{"time_s": 1}]}),
    (["--backend.unknown", "1", "--seed", "2"], {"backend.unknown": "1", "seed": "2"}),
    # a mistyped key takes its values along
    (["--scene.motion.spin_rmp", "0", "8", "0"], {"scene.motion.spin_rmp": ["0", "8", "0"]}),
]


@pytest.mark.parametrize(("words", "overrides"), OVERRIDES)
def test_keys_of_the_configuration_are_told_from_options_and_arguments(
    words: list[str], overrides: dict[str, Any]
) -> None:
    command, found = parse("run", RunCommand, [*words, "-o", "R"])
    assert (found, command.output) == (overrides, Path("R"))
    assert command.config == (Path("c.yaml") if "c.yaml" in words else None)


def test_options_are_converted_to_their_types() -> None:
    plan, _ = parse("plan", PlanCommand, ["-oD", "--dock-axis", "-1", "0", "1e3", "R", "--members=7"])
    assert (plan.run, plan.output, plan.members) == (Path("R"), Path("D"), 7)
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
    config.write_text("backend: {accel_psd: small}\n")
    assert f"{config}: key 'backend.accel_psd': expected a number" in error_line(arguments, capsys)
    config.write_text("backend: {inertia: ratios}\n")
    assert "expected one of second_moments, ratios_axes" in error_line(arguments, capsys)
    config.write_text("")
    for words, said in (
        ("--backend.accel-psd small", "'backend.accel_psd': expected a number, got text 'small'"),
        ("--backend.accel-psd 1e308", "'backend.accel_psd': must be at most"),
        ("--runtime.workers -1", "'runtime.workers': must be at least 0, got"),
    ):
        assert f"command line: key {said}" in error_line([*arguments, *words.split()], capsys)


def camera(folder: Path, index: int) -> Path:
    return folder / "mav0" / f"cam{index}"


def images(folder: Path) -> list[Path]:
    return sorted(camera(folder, 0).glob("data/*.png"))


def truncated(folder: Path) -> None:
    for path in images(folder)[:4]:
        path.write_bytes(path.read_bytes()[:500])


def black(folder: Path) -> None:
    for path in folder.glob("mav0/cam*/data/*.png"):
        write_png(path, np.zeros((48, 64), dtype=np.uint8))


def test_the_configuration_may_be_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    seen: list[Config] = []

    def fake(values: Config, *arguments: Any, **more: Any) -> Result:
        seen.append(values)
        return Result("ok", tmp_path / "report.html")

    monkeypatch.setattr(polhode.pipeline.run, "run", fake)
    folders = ["--data", str(tmp_path), "-o", str(tmp_path / "run")]
    assert main(["run", *folders]) == 0
    assert main(["run", *folders, "--seed", "7"]) == 0
    assert seen == [Config(), Config(seed=7)]
    assert load_config(ROOT / "configs" / "default.yaml") == Config()


BAD_DATA: dict[str, tuple[Callable[[Path], None], str]] = {
    "images truncated": (truncated, "4 of 6 frames are missing, unpaired or unreadable"),
    "black frames": (black, "all frames are black"),
}


@pytest.mark.parametrize("name", BAD_DATA)
def test_bad_data_is_one_line_exit_2_and_leaves_nothing(
    small_sequence: Path, config: Path, tmp_path: Path, name: str, capsys: Capture
) -> None:
    damage, expected = BAD_DATA[name]
    damage(small_sequence)
    before = sorted(tmp_path.iterdir())
    line = error_line(run_arguments(config, small_sequence, tmp_path / "run"), capsys)
    assert expected in line
    assert str(small_sequence) in line
    assert sorted(tmp_path.iterdir()) == before


def test_a_missing_folder_is_one_line_and_exit_2(config: Path, tmp_path: Path, capsys: Capture) -> None:
    line = error_line(run_arguments(config, tmp_path / "none", tmp_path / "run"), capsys)
    assert f"{tmp_path / 'none'} is not a folder" in line


def old_run(folder: Path) -> dict[str, bytes]:
    folder.mkdir()
    write_config(folder, Config())
    write_summary(build_summary(None, None, None, {}, failure="black"), folder / "summary.json")
    (folder / "trajectory.csv").write_text("old")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_a_run_that_exists_is_refused_or_stays_whole_when_the_new_one_is_bad(
    small_sequence: Path, config: Path, tmp_path: Path, more: list[str], capsys: Capture
) -> None:
    content = old_run(tmp_path / "run")
    if more:
        truncated(small_sequence)
    line = error_line(run_arguments(config, small_sequence, tmp_path / "run", *more), capsys)
    assert ("--overwrite" in line) != bool(more)
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == content


def test_simulate_without_a_scene_is_one_line_and_exit_2(
    config: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert "no 'scene' to simulate" in error_line(
        ["simulate", str(config), "-o", str(tmp_path / "s")], capsys
    )


@dataclass(frozen=True)
class Result:
    status: str
    report_path: Path
    sentence: str = "Found it."
    failure: str | None = None
    note: str = ""


@pytest.mark.parametrize(("status", "code"), [("ok", 0), ("degraded", 0), ("failed", 1)])
def test_the_last_line_of_a_run_ends_with_the_report_however_long(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, status: str, code: int
) -> None:
    report = tmp_path / ("long name " * 20) / "report.html"
    seen: list[Any] = []

    def fake(values: Config, *arguments: Any, **more: Any) -> Result:
        seen.append(values)
        return Result(status, report, failure="the solver stopped" if status == "failed" else None)

    monkeypatch.setattr(polhode.pipeline.run, "run", fake)
    arguments = run_arguments(config, tmp_path, tmp_path / "run", "--backend.inertia", "ratios_axes")
    assert main(arguments) == code
    assert capsys.readouterr().out.splitlines()[-2:] == ["Found it.", f"Report: {report}"]
    assert (seen[0].seed, seen[0].backend.inertia) == (1, "ratios_axes")


def test_the_warnings_of_a_run_are_listed_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    report = tmp_path / "report.html"

    def fake(*arguments: Any, **more: Any) -> Result:
        summary = build_summary(
            None, None, None, {}, ["3 frames are lost", "a line\nbreaks"], failure="no motion"
        )
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


def test_a_failed_run_is_one_line_and_exit_1(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def fail(*arguments: Any, **more: Any) -> None:
        raise RunFailure("no motion fits")

    monkeypatch.setattr(polhode.pipeline.run, "run", fail)
    line = error_line(run_arguments(config, tmp_path, tmp_path / "run"), capsys, code=1)
    assert "no motion fits" in line


def test_an_unexpected_error_shows_its_traceback_only_with_debug(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def fail(command: EvaluateCommand) -> Answer:
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr(EvaluateCommand, "execute", fail)
    assert "ZeroDivisionError: a b" in error_line(["evaluate", "R", "S"], capsys, code=1)
    assert main(["--debug", "evaluate", "R", "S"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_help_lists_every_command_and_every_value_with_its_default(capsys: Capture) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in COMMANDS)
    for command, not_its in (("simulate", "--train"), ("train", "--scene")):
        assert main([command, "--help"]) == 0
        text = capsys.readouterr().out
        assert [name for name in setting_names() if name not in text and not name.startswith(not_its)] == []
        assert "(default: 1e-06)" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_every_option_in_one_group_and_the_short_one_the_common_ones(
    command: str, capsys: Capture
) -> None:
    options = options_of(COMMANDS[command]).values()
    groups = COMMANDS[command].GROUPS
    rare = [f"--{name.replace('_', '-')}" for names in groups.values() for name in names]
    assert len(set(rare)) == len(rare) and set(rare) <= {option.names[0] for option in options}
    assert main([command, "--help"]) == 0
    everything = capsys.readouterr().out
    assert main([command, "-h"]) == 0
    short = capsys.readouterr().out
    listed = short.partition("-h, --help ")[2]
    titles = [f"{title} options" for title in (*groups, "general")]
    if issubclass(COMMANDS[command], ConfiguredCommand):
        titles.append("backend options")
    places = [everything.index(title) for title in titles]
    assert places == sorted(places)
    for option in options:
        if not option.is_positional:
            assert re.search(rf"\W{option.names[0]}\W", everything), option
            assert bool(re.search(rf"  ?{option.names[0]}[ ,]", listed)) == (option.names[0] not in rare), (
                option
            )
    assert (f"polhode {command} --help shows all" in short) == (len(everything) > len(short))
    assert short.count("\n") < 60


@pytest.mark.parametrize("command", COMMANDS)
def test_the_usage_has_in_brackets_what_may_be_left_out(command: str, capsys: Capture) -> None:
    assert main([command, "-h"]) == 0
    usage = " ".join(capsys.readouterr().out.partition("\n\n")[0].split())
    assert usage.startswith(f"usage: polhode {command} ") and usage.endswith(" [OPTIONS]")
    for option in options_of(COMMANDS[command]).values():
        if option.is_positional:
            assert (f"[{option.metavar}]" in usage) == (not option.required)
        else:
            assert (f" {option.invocation} " in usage) == option.required


MAIN_COMMANDS = ("run", "simulate", "evaluate", "compare", "export", "predict", "plan")


@pytest.mark.parametrize("command", MAIN_COMMANDS)
def test_the_examples_of_the_help_stand_before_the_options_and_are_command_lines(
    command: str, capsys: Capture
) -> None:
    assert main([command, "-h"]) == 0
    text = capsys.readouterr().out
    examples = COMMANDS[command].EXAMPLES
    assert 1 <= len(examples) <= 2
    for line, _ in examples:
        assert text.index(f"\n  {line}\n") < text.index("-h, --help ")
        program, name, *words = shlex.split(line)
        assert (program, name) == ("polhode", command)
        _, overrides = parse(command, COMMANDS[command], words)
        assert set(overrides) <= {name.removeprefix("--").replace("-", "_") for name in setting_names()}
        assert all((ROOT / word).exists() for word in words if word.startswith("configs/"))


class _Utf8(io.StringIO):
    encoding = "utf-8"


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_wrapped_at_the_width_of_the_terminal_and_nowhere_else(
    command: str, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    with contextlib.redirect_stdout(_Utf8()) as printed:
        assert main([command, "--help"]) == 0
    lines = printed.getvalue().splitlines()
    assert all(len(line) <= columns for line in lines)
    boxed = [line.strip("│╭╮╰╯─").rstrip() if line.startswith("│") else "" for line in lines]
    for line, following in pairwise(boxed):
        # lines of a description are indented, at least where it goes on; names stand alone on a line
        goes_on = line.startswith(" " * 5) or re.match(r" -\S.*\S  +\S", line)
        if goes_on and following.startswith(" " * 5):
            assert len(line) + 1 + len(following.split()[0]) > columns - 3, (line, following)


def test_the_overview_has_every_command_once_and_its_summary_is_a_sentence(capsys: Capture) -> None:
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    named = [line.split()[0] for line in lines if re.match(r"  [a-z]+  ", line)]
    assert sorted(named) == sorted(COMMANDS)
    for command in COMMANDS.values():
        assert (command.__doc__ or "").partition("\n")[0].rstrip().endswith(".")


def test_help_is_quick_because_nothing_heavy_is_imported() -> None:
    heavy = "numpy scipy torch cv2 casadi numba kornia trimesh plotly skimage"
    code = (
        "import sys; from polhode.cli.main import main; assert main(['run', '--help']) == 0;"
        f"sys.exit(' '.join(set('{heavy}'.split()) & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_program_itself_exits_with_the_code() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "polhode", "run", "none.yaml", "--data", "S", "-o", "R"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == "polhode: error: none.yaml is missing: give an existing configuration file\n"
    assert done.stdout == ""
