"""README.md: every command runs in the order in which a reader meets it; every number is that of a record.

Commands of ``make`` are looked up in the Makefile, benchmarks in the registry. The others run in a folder
where LEFT, RIGHT and RIG are a small recording; ``SHORTER`` says what is added so that a line takes seconds.
"""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import pytest

from benchmarks.end_to_end import against_slam, footprint, thesis
from benchmarks.presentation import markdown_table
from benchmarks.record import lines_of
from benchmarks.registry import BENCHMARKS
from polhode.cli.main import COMMANDS, main
from release.trial import LIGHT, PAIRS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROGRAM = ".venv/bin/polhode"
SHORTER = {
    "run": (*LIGHT, "--frontend.features.second", "None"),
    "simulate": (
        *("--scene.frames", "3", "--scene.truth-horizon-s", "0", "--scene.render.samples", "1"),
        *("--scene.rig.width-px", "96", "--scene.rig.height-px", "72", "--scene.rig.focal-px", "90"),
    ),
    "compare": ("--compare.solvers", "gauss_newton"),
    "export": ("--pieces", "2"),
    "plan": ("--horizon", "3", "--confidence", "0.9", "--members", "100"),
}
"""By subcommand: options that change how long a line takes, not what it does."""


@dataclass(frozen=True)
class Block:
    """A block of code of the page."""

    language: str
    text: str


def blocks(page: str) -> list[Block]:
    """In their order."""
    return [Block(*found) for found in re.findall(r"^```(\w*)\n(.*?)^```$", page, re.M | re.S)]


def commands(page: str) -> list[list[str]]:
    """The words of every line of a block that begins with a program, without its comment."""
    lines = [line for block in blocks(page) if not block.language for line in block.text.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [each for each in words if each and each[0] in (PROGRAM, "make", "python")]


@pytest.fixture
def recording(rendered_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with the images of two cameras and their calibration as a reader has them."""
    for name, camera in (("LEFT", "cam0"), ("RIGHT", "cam1")):
        (tmp_path / name).mkdir()
        for image in sorted((rendered_sequence / "mav0" / camera / "data").iterdir())[:PAIRS]:
            (tmp_path / name / image.name).symlink_to(image)
        (tmp_path / "RIG" / camera).mkdir(parents=True)
        sensor = rendered_sequence / "mav0" / camera / "sensor.yaml"
        (tmp_path / "RIG" / camera / "sensor.yaml").symlink_to(sensor)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("coarse_keep_out")
def test_every_command_runs_in_order(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of the program, then the lines of Python."""
    ours = [words[1:] for words in commands(README) if words[0] == PROGRAM]
    assert {"import", "checkout", "run", "predict", "plan", "observability", "export", "compare"} <= {
        words[0] for words in ours
    }
    for words in ours:
        code = main([*words, *SHORTER.get(words[0], ())])
        assert code == 0, f"{shlex.join(words)}: {capsys.readouterr().err}"
    results = (
        "RUN/report.html",
        "prediction.csv",
        "PLAN/plan.txt",
        "EDGES/observability.json",
        "target.urdf",
    )
    assert [name for name in results if not (recording / name).is_file()] == []
    for block in blocks(README):
        if block.language == "python":
            exec(block.text, {})  # noqa: S102  the page of this repository
    assert capsys.readouterr().out


def test_commands_of_make_and_benchmarks_exist() -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    made = {words[1] for words in commands(README) if words[0] == "make"}
    made |= set(re.findall(r"`(?:time )?make (\w[\w-]*)", README))
    assert made and made <= targets
    modules = set(re.findall(r"`python -m benchmarks\.([\w.]+)", README))
    assert modules and modules <= {each.module for each in BENCHMARKS}


def test_commands_in_the_text_exist() -> None:
    named = set(re.findall(r"`(?:\.venv/bin/)?polhode (\w+)", README))
    assert named and named <= set(COMMANDS)


def test_the_table_beside_the_thesis_is_that_of_the_record() -> None:
    (line,) = lines_of(thesis.RECORD)
    assert markdown_table(thesis.HEAD, thesis.table_rows(line)) in README


def test_the_table_beside_other_programs_is_that_of_the_record() -> None:
    rows = [against_slam.row_of(line) for line in lines_of(against_slam.RECORD)]
    assert markdown_table(against_slam.HEAD, rows) in README


def test_disk_and_memory_are_those_of_the_record() -> None:
    for line in lines_of(footprint.RECORD):
        name, _, value = footprint.line_of(line).partition(": ")
        assert f"| {name} | {value}" in README


def test_the_replica_of_the_thesis_has_the_errors_of_the_page_about_scenes() -> None:
    page = (ROOT / "docs/scenes.md").read_text(encoding="utf-8")
    row = next(line for line in page.splitlines() if line.startswith("| ts38 |"))
    (line,) = lines_of(thesis.RECORD)
    position, velocity, rate, attitude = (float(cell) for cell in row.split("|")[2:6])
    assert line["position_mm"] == pytest.approx(position, abs=6e-4)
    assert line["velocity_mm_s"] == pytest.approx(velocity, abs=6e-4)
    assert line["angular_velocity_deg_s"] == pytest.approx(rate, abs=6e-5)
    assert line["attitude_deg"] == pytest.approx(attitude, abs=6e-5)


def test_pictures_are_small_and_the_animation_repeats_without_end() -> None:
    from PIL import Image

    names = re.findall(r"(?:\]\(|src=\")(docs/images/[^)\"]+)", README)
    assert names[0].endswith("tumbling.webp")
    assert all((ROOT / name).stat().st_size <= 2.5e6 for name in names)
    with Image.open(ROOT / names[0]) as animation:
        assert getattr(animation, "n_frames", 1) > 100 and animation.info["loop"] == 0
