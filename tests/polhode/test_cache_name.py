"""What is kept on disk of compiled functions is not taken for that of other constants."""

import os
import subprocess
import sys
from pathlib import Path


def run(folder: Path, size: str) -> str:
    """Write the constant's module, then call the compiled loop of another one in a process of its own."""
    (folder / "sizes.py").write_text(f"EDGE = {size}\n")
    environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{Path.cwd()}"}
    command = [sys.executable, "-B", "-c", "import kept; print(kept.outer())"]
    found = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    return found.stdout.strip()


def test_a_constant_of_another_module_that_changes_is_compiled_anew(tmp_path: Path) -> None:
    for package in ("mapping", "backend"):
        folder = tmp_path / package
        folder.mkdir()
        (folder / "inner.py").write_text(
            f"from {package}.compiled import compiled\nfrom sizes import EDGE\n\n\n"
            "@compiled\ndef edge() -> int:\n    return EDGE\n"
        )
        (folder / "kept.py").write_text(
            f"from {package}.compiled import compiled\nfrom inner import edge\nfrom sizes import EDGE\n\n\n"
            "@compiled\ndef outer() -> int:\n    return 100 * EDGE + edge()\n"
        )
        assert run(folder, "8") == "808"
        names = sorted(path.name for path in folder.rglob("*.nbi"))
        assert run(folder, "8") == "808"
        # loaded, not compiled again
        assert sorted(path.name for path in folder.rglob("*.nbi")) == names and len(names) == 2
        assert run(folder, "4") == "404"
