"""Pictures do not depend on a ``matplotlibrc``, and leave the settings of the program that asks for them."""

import ast
import io
from pathlib import Path
from typing import Any

import matplotlib
import pytest
from matplotlib.figure import Figure

from polhode.runtime.drawing_style import default_style

ROOT = Path(__file__).parents[2] / "polhode"
FOREIGN: dict[Any, Any] = {
    "text.usetex": True,
    "figure.facecolor": "red",
    "savefig.dpi": 30,
    "lines.linewidth": 20.0,
}


@default_style
def drawn() -> bytes:
    figure = Figure(figsize=(2.0, 2.0))
    figure.subplots().plot([0.0, 1.0], label="a line")
    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def test_settings_of_others_change_nothing_and_stay() -> None:
    expected = drawn()
    with matplotlib.rc_context(FOREIGN):
        assert drawn() == expected
        assert matplotlib.rcParams["text.usetex"] and matplotlib.rcParams["lines.linewidth"] == 20.0


@pytest.mark.parametrize("room", ["pipeline", "report", "simulation", "compare", "planning", "mapping"])
def test_every_function_that_makes_a_figure_or_calls_one_that_does_has_the_style(room: str) -> None:
    """A function that is called by such a function of its module needs no style of its own."""
    for path in sorted((ROOT / room).rglob("*.py")):
        text = path.read_text()
        if "from matplotlib.figure import Figure" not in text:
            continue
        functions = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
        called = {name: _called(node) for name, node in functions.items()}
        draws = {name for name, names in called.items() if names & {"Figure", "savefig"}}
        for name in draws - {"png"}:
            callers = {other for other, names in called.items() if name in names}
            styled = any("default_style" in ast.dump(each) for each in functions[name].decorator_list)
            for caller in callers:
                decorators = functions[caller].decorator_list
                assert styled or any("default_style" in ast.dump(each) for each in decorators), caller
            assert styled or callers, f"{path}: {name}"


def _called(function: ast.FunctionDef) -> set[str]:
    names = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Call):
            names.add(
                node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            )
    return names
