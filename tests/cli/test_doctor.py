"""polhode doctor: the installation, the machine, and a self-test of real work."""

import json
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import pytest

from polhode.cli import doctor
from polhode.cli.main import main
from polhode.runtime.errors import RunFailure
from polhode.runtime.optional_parts import OPTIONAL_PARTS

Capture = pytest.CaptureFixture[str]


def test_it_names_the_machine_and_the_optional_parts_and_its_self_test_passes_here(capsys: Capture) -> None:
    main(["doctor", "--json", "--quiet"])
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (answer["status"], answer["exit_code"]) == ("ok", 0)
    found = answer["figures"]
    checks = found["self_test"]
    assert [each["name"] for each in checks] == list(doctor.CHECKS)
    assert all(each["holds"] for each in checks)
    assert "ipopt solved a simulated tumble" in checks[2]["finding"]
    assert found["processors"] >= 1 and found["memory_gib"] >= found["free_memory_gib"] > 0.0
    assert [part["extra"] for part in found["optional_parts"]] == [part.extra for part in OPTIONAL_PARTS]
    assert main(["doctor", "--skip-test"]) == 0
    text = capsys.readouterr().out
    assert all(part.purpose in text for part in OPTIONAL_PARTS)
    assert "Self-test" not in text and text.endswith("doctor: what polhode needs is installed\n")


def test_each_row_is_printed_as_it_is_found_and_what_is_wrong_is_one_line_and_exit_1(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    printed: list[str] = []

    def look() -> str:
        printed.append(capsys.readouterr().out)
        return "fine"

    def broken() -> str:
        look()
        raise OSError("libtorch.so:\ncannot open shared object file")

    monkeypatch.setattr(doctor, "CHECKS", {"first": look, "networks": broken})
    monkeypatch.setattr(doctor, "wrong_packages", lambda: ["numba 0.1 does not meet >=0.60"])
    assert main(["doctor"]) == 1
    before, between = printed
    assert before.startswith("polhode ") and before.endswith("\nSelf-test:\n")
    assert between.startswith("  ok   first ") and between.count("\n") == 1
    captured = capsys.readouterr()
    assert captured.out.endswith("doctor: 2 faults\n")
    assert captured.err == (
        "polhode: error: this installation does not work: numba 0.1 does not meet >=0.60; networks: OSError: "
        "libtorch.so: cannot open shared object file\n"
    )


def test_packages_and_the_memory_of_a_container_are_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def version(name: str) -> str:
        if name == "b":
            raise PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(doctor, "requires", lambda name: ["a>=2", "b>=1", "c>=1", 'd>=9; extra == "dev"'])
    monkeypatch.setattr(doctor, "version", version)
    assert doctor.wrong_packages() == ["a 1.0 does not meet >=2", "b is missing"]
    meminfo, limit = tmp_path / "meminfo", tmp_path / "memory.max"
    meminfo.write_text("MemTotal:       8388608 kB\nMemAvailable:   6291456 kB\n")
    monkeypatch.setattr(doctor, "MEMINFO", meminfo)
    monkeypatch.setattr(doctor, "CGROUP_LIMITS", (limit,))
    for text, memory in (("max\n", (8.0, 6.0)), (f"{4 * 2**30}\n", (4.0, 4.0))):
        limit.write_text(text)
        assert doctor.memory_gib() == memory
    meminfo.unlink()
    assert doctor.memory_gib() == (4.0, None)


def test_each_check_can_fail(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def no_motion(*_: object) -> None:
        raise RunFailure("no motion fits")

    monkeypatch.setattr("polhode.frontend.networks.weights.shipped_path", lambda name: tmp_path / "none")
    monkeypatch.setattr("polhode.simulation.dataset.plan.plan_sequence", no_motion)
    monkeypatch.setattr("polhode.backend.initialize_motion", no_motion)
    monkeypatch.setattr("polhode.runtime.processes.in_order", lambda work, items, workers: [])
    checks = list(doctor.self_test())
    assert [each["holds"] for each in checks] == [False] * len(doctor.CHECKS)
    assert "the weights are missing" in checks[0]["finding"]
