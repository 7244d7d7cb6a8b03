"""Pictures do not depend on a ``matplotlibrc``, and leave the settings of the program that asks for them."""

import io
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from polhode.runtime.drawing_style import default_style

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


def test_every_module_that_makes_a_figure_has_the_style() -> None:
    for path in sorted((Path(__file__).parents[2] / "polhode").rglob("*.py")):
        text = path.read_text()
        if "from matplotlib.figure import Figure" in text and " = Figure(" in text:
            assert "@default_style" in text, path
