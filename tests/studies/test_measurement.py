"""A function of the user measures the points of a study."""

from pathlib import Path
from typing import Any

import pytest

from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.studies import sweep as flow
from polhode.studies.cluster import ClusterOptions
from polhode.studies.measurement import measurement_of
from polhode.studies.study import open_study
from polhode.studies.table import read_table
from tests.studies.conftest import SCENE, Sweep, WriteStudy, timeless

CODE = """
import neighbour

def measure(point):
    (point.folder / "note.txt").write_text("kept")
    frames = None if point.config.scene is None else point.config.scene.frames
    return {"twice": neighbour.FACTOR * point.case["x"], "frames": frames, "run": str(point.run)}

def fail(point):
    raise ValueError("no " + point.case["kind"])

NUMBER = 3
"""


@pytest.fixture
def code(tmp_path: Path) -> Path:
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "neighbour.py").write_text("FACTOR = 2")
    (folder / "code.py").write_text(CODE)
    return folder / "code.py"


def swept(study: Path, function: str, folder: Path) -> flow.Swept:
    opened = open_study(study, measurement=measurement_of(function))
    return flow.sweep(opened, folder, Silent(), ClusterOptions())


def test_what_a_function_returns_becomes_columns(
    sweep_here: Sweep, write_study: WriteStudy, code: Path, tmp_path: Path
) -> None:
    points = [{"case.x": 1, "case.kind": "a"}, {"case": {"x": 2}}]
    study = write_study(points=points, axes={"seed": [1, 2]}, steps=["measure"], keep="whole")
    assert swept(study, f"{code}:measure", tmp_path / "out").failed == 0
    table = read_table(tmp_path / "out").to_pydict()
    assert table["seed"] == [1, 1, 2, 2]
    assert table["case.x"] == [1, 2, 1, 2] and table["case.kind"] == ["a", None, "a", None]
    assert table["measure.twice"] == [2, 4, 2, 4] and table["measure.run"] == 4 * ["None"]
    assert len(list((tmp_path / "out" / "runs").glob("*/measured/note.txt"))) == 4
    before = timeless(tmp_path / "out")
    assert swept(study, f"{code}:measure", tmp_path / "out").stored == 4
    assert timeless(tmp_path / "out").equals(before)
    # another function, and other code, are other points
    assert swept(study, f"{code}:fail", tmp_path / "out").stored == 0
    assert "measure: unexpected ValueError: no a" in read_table(tmp_path / "out").to_pydict()["reason"]
    code.write_text(CODE.replace("FACTOR *", "FACTOR +"))
    assert swept(study, f"{code}:measure", tmp_path / "out").stored == 0


def test_it_is_given_the_configuration_and_the_sequence_of_the_point(
    sweep_here: Sweep, write_study: WriteStudy, code: Path, tmp_path: Path
) -> None:
    code.write_text(
        "def measure(point):\n"
        "    return {'pairs': point.config.scene.frames, 'seq': point.sequence.is_dir()}\n"
    )
    study = write_study(base={"scene": SCENE}, axes={"scene.frames": [1, 2]}, steps=["simulate", "measure"])
    swept(study, f"{code}:measure", tmp_path / "out")
    table = read_table(tmp_path / "out").to_pydict()
    assert table["measure.pairs"] == [1, 2] and table["measure.seq"] == [True, True]


def test_a_function_that_there_is_not_is_named(code: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code.parent / "broken.py").write_text("def measure(:")
    monkeypatch.chdir(code.parent)
    for words, said in (
        ("code.py", "give a file and a function"),
        ("code.txt:measure", "give a file and a function"),
        ("none.py:measure", "none.py is missing"),
        ("code.py:absent", "has no function 'absent'"),
        ("code.py:NUMBER", "has no function 'NUMBER'"),
        ("broken.py:measure", r"cannot be loaded \(SyntaxError"),
    ):
        with pytest.raises(InputError, match=said):
            measurement_of(words)


def test_a_study_that_does_not_fit_is_refused(write_study: WriteStudy, code: Path) -> None:
    seed, one = {"points": [{"seed": 1}]}, {"count": 1, "settings": {"seed": {"values": [1]}}}
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"steps": ["measure"]}, "steps: 'measure' needs a function: --measure"),
        ({"axes": {"case.x": [1, 2]}}, "settings of 'case' are for the step 'measure'"),
        ({"points": [{"seed": 1}, {"seed": 1}]}, "points: .* comes twice"),
        ({"points": [{"sed": 1}]}, "'sed' is no setting"),
        ({"points": [{"seed": -1}]}, "seed"),
        (seed | {"axes": {"seed": [1]}}, "is set by seed and by seed"),
        (seed | {"design": one}, "points, design: both name settings"),
    )
    for content, said in cases:
        with pytest.raises(InputError, match=said):
            open_study(write_study(**{"steps": [], **content}))
    with pytest.raises(InputError, match="has no step 'measure'"):
        open_study(write_study(steps=[]), measurement=measurement_of(f"{code}:measure"))
