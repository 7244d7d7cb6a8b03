"""The static rules that keep code of others from being executed are on, and they find what they should."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "import pickle": "TID251",
    "import marshal": "TID251",
    "import shelve": "TID251",
    "import dill": "TID251",
    "from joblib import load": "TID251",
    "import torch; torch.load('x')": "TID251",
    "import torch; torch.hub.load('x', 'y')": "TID251",
    "eval(input())": "S307",
    "exec(input())": "S102",
    "import os; os.system('ls')": "S605",
    "import subprocess; subprocess.run('ls', shell=True)": "S602",
    "import yaml; yaml.load('', Loader=yaml.Loader)": "S506",
    "import tempfile; tempfile.mktemp()": "S306",
    "import jinja2; jinja2.Environment()": "S701",
}


def test_what_would_execute_code_of_others_is_refused() -> None:
    """As ``make check`` runs it, on a file of a room: a line for each."""
    options = ["--no-cache", "--output-format", "concise", "--stdin-filename", "polhode/compare/x.py"]
    command = [sys.executable, "-m", "ruff", "check", *options, "-"]
    done = subprocess.run(
        command, input="\n".join(FORBIDDEN), cwd=ROOT, capture_output=True, text=True, check=False
    )
    found = re.findall(r"polhode/compare/x\.py:(\d+):\d+: ([A-Z]+\d+)", done.stdout)
    for line, rule in enumerate(FORBIDDEN.values(), start=1):
        assert (str(line), rule) in found, done.stdout


def test_no_archive_is_read_or_written_with_pickles() -> None:
    """NumPy's own switch has no rule; the one test that makes such a file is allowed it."""
    found = {
        str(path.relative_to(ROOT))
        for folder in ROOT.glob("[a-z]*")
        for path in folder.rglob("*.py")
        if re.search(r"allow_pickle\s*=\s*True", path.read_text())
    }
    assert found <= {"tests/compare/problem/test_problem_file.py", "tests/test_static_rules.py"}


def test_rooms_read_archives_of_arrays_through_the_module_that_checks_them() -> None:
    """``array_files`` reads what headers state before NumPy allocates it, and unpickles nothing."""
    found = {
        str(path.relative_to(ROOT))
        for folder in (ROOT / name for name in ("polhode", "frontend", "backend", "train"))
        for path in folder.rglob("*.py")
        if re.search(r"\bnp\.load\(|\bnumpy\.load\(", path.read_text())
    }
    assert found == set()
