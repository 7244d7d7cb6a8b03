"""The cache of compiled functions is not used for constants other than those that were compiled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def result_with(folder: Path, size: str, first: str = "") -> str:
    """Write the constant's module, then call the compiled function of another one in a separate process."""
    (folder / "sizes.py").write_text(f"EDGE = {size}\n")
    environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{Path.cwd()}"}
    command = [sys.executable, "-B", "-c", f"{first}import kept; print(kept.outer())"]
    found = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    return found.stdout.strip()


SEVEN = "from polhode.runtime.compiled import compiled\n\n\n@compiled\ndef outer() -> int:\n    return 7\n"


@pytest.mark.parametrize("variant", ["compiled", "compiled_fused_ieee"])
def test_a_changed_constant_of_another_module_leads_to_a_new_compilation(
    variant: str, tmp_path: Path
) -> None:
    decorator = f"from polhode.runtime.compiled import {variant}\n"
    (tmp_path / "inner.py").write_text(
        f"{decorator}import sizes\n\n\n@{variant}\ndef edge() -> int:\n    return sizes.EDGE\n"
    )
    (tmp_path / "kept.py").write_text(
        f"{decorator}from inner import edge\nfrom sizes import EDGE\n\n\n"
        f"@{variant}\ndef outer() -> int:\n    return 100 * EDGE + edge()\n"
    )
    assert result_with(tmp_path, "8") == "808"
    names = sorted(path.name for path in tmp_path.rglob("*.nbi"))
    assert result_with(tmp_path, "8") == "808"
    # loaded, not compiled again
    assert sorted(path.name for path in tmp_path.rglob("*.nbi")) == names and len(names) == 2
    assert result_with(tmp_path, "4") == "404"


def test_a_cache_that_cannot_be_written_or_read_costs_time_only_and_compiling_is_announced(
    tmp_path: Path,
) -> None:
    (tmp_path / "kept.py").write_text(SEVEN)
    cache = tmp_path / "__pycache__"
    limit = "import resource, signal; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100));"
    shown = "import logging, sys; logging.basicConfig(level=25, stream=sys.stdout, format='%(levelname)s');"
    assert result_with(tmp_path, "8", limit) == "7"  # as on a full disk
    assert not list(cache.glob("*.nbc"))
    assert result_with(tmp_path, "8", shown) == "NOTE\n7"
    assert result_with(tmp_path, "8", shown) == "7"
    for path in (*cache.glob("*.nbi"), *cache.glob("*.nbc")):
        path.write_bytes(path.read_bytes()[:-40])
    assert result_with(tmp_path, "8") == "7"
