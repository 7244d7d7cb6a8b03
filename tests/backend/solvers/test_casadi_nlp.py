"""IPOPT reads no options from the current folder, which may be a dataset of another person."""

import re
from pathlib import Path
from typing import Any

import casadi as ca
import pytest

from polhode.backend.solvers.casadi_nlp import ipopt_options

ROOT = Path(__file__).parents[3]
LAUNCH = re.compile(r"\.solver\(|\bnlpsol\(")


@pytest.mark.parametrize("ours", [True, False])
def test_a_file_of_options_writes_no_file(
    ours: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sprung = tmp_path / "sprung"
    (tmp_path / "ipopt.opt").write_text(f"output_file {sprung}\nfile_print_level 5\n")
    monkeypatch.chdir(tmp_path)
    x = ca.SX.sym("x")
    ipopt = ipopt_options(1e-6, 1e-9, 50)["ipopt"] if ours else {"print_level": 0, "sb": "yes"}
    options: dict[str, Any] = {"print_time": False, "ipopt": ipopt}
    ca.nlpsol("one", "ipopt", {"x": x, "f": x * x}, options)()
    assert sprung.exists() == (not ours)


def test_wherever_ipopt_is_started_it_is_told_so() -> None:
    starts = [
        path
        for folder in ("backend", "polhode/planning", "lab")
        for path in (ROOT / folder).rglob("*.py")
        if LAUNCH.search(text := path.read_text()) and '"ipopt"' in text and "casadi" in text
    ]
    assert {path.name for path in starts} >= {"casadi_nlp.py", "trajectory.py"}
    silent = [str(path) for path in starts if '"option_file_name"' not in path.read_text()]
    assert silent == []
