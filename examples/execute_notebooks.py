"""Execute the notebooks of examples/notebooks and store what they print and draw.

make demo
pip install '.[notebook]'
python -m examples.execute_notebooks            those that are in the repository, on the run of the demo
python -m examples.execute_notebooks RUN        on another run; nothing is stored

A notebook that raises an error ends the command with it.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parent / "notebooks"
TIMEOUT_S = 600
FORGET = "%reset -f"


@contextmanager
def kernel() -> Iterator[KernelManager]:
    """A kernel for several notebooks, in their folder: what they import is loaded once."""
    with TemporaryDirectory(prefix="kernel-") as folder:
        # Sockets in a folder of the user's own, not ports that others reach.
        manager = KernelManager(transport="ipc", connection_file=f"{folder}/k.json")
        manager.start_kernel(cwd=str(FOLDER))
        try:
            yield manager
        finally:
            manager.shutdown_kernel(now=True)


def notebooks() -> list[Path]:
    """Those of the repository, in the order in which they are read."""
    return sorted(FOLDER.glob("*.ipynb"))


def execute(path: Path, manager: KernelManager) -> NotebookNode:
    """The notebook with its outputs. The kernel forgets the names of an earlier one first.

    Raises CellExecutionError of nbclient: a cell raises an error.
    """
    notebook: NotebookNode = nbformat.read(path, as_version=4)
    forget = nbformat.v4.new_code_cell(FORGET)
    notebook.cells.insert(0, forget)
    NotebookClient(notebook, km=manager, timeout=TIMEOUT_S, record_timing=False).execute()
    notebook.cells.remove(forget)
    for number, cell in enumerate((each for each in notebook.cells if each.cell_type == "code"), start=1):
        cell.execution_count = number
        for output in cell.outputs:
            if output.output_type == "execute_result":
                output.execution_count = number
    return notebook


def main(arguments: Sequence[str]) -> None:
    """Execute them one after the other."""
    if arguments:
        os.environ["POLHODE_RUN"] = str(Path(arguments[0]).resolve())
    with kernel() as manager:
        for path in notebooks():
            notebook = execute(path, manager)
            if not arguments:
                nbformat.write(notebook, path)
            print(path.name)


if __name__ == "__main__":
    main(sys.argv[1:])
