"""The command that tries deliberate faults, on a repository of one module and one test."""

from pathlib import Path

import yaml

from benchmarks.command import ROOT
from benchmarks.mutation.catch import FAULTS, Fault, place_of, table, try_all

MODULE = "def double(x):\n    return 2 * x\n"
TEST = "from module import double\n\n\ndef test_it_doubles():\n    assert double(3) == 6\n"


def fault(old: str, new: str) -> Fault:
    return Fault("wrong factor", "module.py", old, new, ("test_module.py",))


def test_a_fault_is_caught_survives_or_is_out_of_date(tmp_path: Path) -> None:
    tree, copies = tmp_path / "tree", tmp_path / "copies"
    (tree / "tests").mkdir(parents=True)
    copies.mkdir()
    (tree / "module.py").write_text(MODULE)
    (tree / "tests" / "test_module.py").write_text(TEST)
    faults = [fault("2 * x", "3 * x"), fault("2 * x", "x * 2"), fault("4 * x", "x")]
    caught, survived, renamed = try_all(faults, tree, copies, 1)
    assert caught.caught_by == "tests/test_module.py::test_it_doubles" and not caught.trouble
    assert not survived.caught_by and not survived.trouble
    assert not renamed.caught_by and "renew the fault" in renamed.trouble
    assert (copies / "0" / "module.py").read_text() == (tree / "module.py").read_text() == MODULE
    lines = table([caught, survived, renamed]).splitlines()
    assert "`test_module.py::test_it_doubles`" in lines[2] and "**nothing**" in lines[3]
    assert lines[-1] == "1 of 3 faults are caught."


def test_every_fault_has_one_place_in_the_code_and_its_tests_exist() -> None:
    faults = [Fault(**each) for each in yaml.safe_load(FAULTS.read_text())]
    assert len(faults) >= 40
    for each in faults:
        assert place_of(each, ROOT) == ROOT / each.file, each.kind
        for test in each.tests:
            file, _, name = test.partition("::")
            path = ROOT / "tests" / file
            assert path.exists() and (not name or f"def {name}(" in path.read_text()), test
