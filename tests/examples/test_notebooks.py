"""The notebooks of examples/notebooks: they run, and what is stored in them is what they show."""

from collections.abc import Iterator

import nbformat
import pytest
from jupyter_client.manager import KernelManager

from examples.execute_notebooks import execute, kernel, notebooks
from tests.pipeline.conftest import make_example, write_example

COARSE = """
from functools import partial
import polhode.api
options = polhode.api.KeepOutOptions
polhode.api.KeepOutOptions = partial(options, cells=options.cells // 2)
"""
"""Keep-out volumes have half the cells a side, as by the fixture ``coarse_keep_out``."""
NAMES = [path.name for path in notebooks()]
MAX_BYTES = 400_000


@pytest.fixture(scope="module")
def manager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KernelManager]:
    """A kernel that reads a small run, and keeps its history to itself."""
    folder = tmp_path_factory.mktemp("notebooks")
    (folder / "run").mkdir()
    write_example(folder / "run", make_example())
    startup = folder / "ipython" / "profile_default" / "startup"
    startup.mkdir(parents=True)
    (startup / "coarse.py").write_text(COARSE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POLHODE_RUN", str(folder / "run"))
        patch.setenv("IPYTHONDIR", str(folder / "ipython"))
        with kernel() as started:
            yield started


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_and_draws(name: str, manager: KernelManager) -> None:
    path = next(path for path in notebooks() if path.name == name)
    executed = execute(path, manager)
    shown, stored = kinds_of(executed), kinds_of(nbformat.read(path, as_version=4))
    assert shown == stored and sum("image/png" in kinds for kinds in shown) >= 1


def kinds_of(notebook: nbformat.NotebookNode) -> list[set[str]]:
    """What each code cell shows, without warnings, which depend on the run."""
    return [
        {kind for output in cell.outputs for kind in output.get("data", [output.get("name")])} - {"stderr"}
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]
