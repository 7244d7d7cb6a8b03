"""``polhode doctor``: whether this installation works, on this machine."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from polhode.cli.answer import Answer
from polhode.cli.console import choose_progress
from polhode.cli.options import Flag

if TYPE_CHECKING:
    from polhode.cli.self_test import Check

LITTLE_MEMORY_GIB = 2.0
"""Below it the answer says so: a run of the sample takes some 1.3 GiB in all its processes."""


@dataclass(frozen=True)
class DoctorCommand:
    """Check the installation: packages, threads, memory, optional parts, and a self-test of some seconds.

    Exit code 0: it works; 1: something that polhode needs is missing or does not work. Optional parts are
    listed with what they are for and the command that adds them; none of them is needed. The first call after
    an installation takes longer, because functions are compiled.
    """

    skip_test: Flag = False
    """Leave out the self-test."""

    def execute(self) -> Answer:
        """Look, test, and say what was found."""
        from polhode.cli.self_test import self_test

        facts, parts = _facts(), _parts()
        checks = [] if self.skip_test else self_test(choose_progress())
        wrong = [
            *facts["wrong_packages"],
            *(f"{each.name}: {each.finding}" for each in checks if not each.holds),
        ]
        works = "what polhode needs is installed" if self.skip_test else "polhode works here"
        return Answer(
            f"doctor: {len(wrong)} faults" if wrong else f"doctor: {works}",
            "\n".join([*_lines_of_facts(facts), *_lines_of_parts(parts), *_lines_of_checks(checks)]),
            figures={**facts, "optional_parts": parts, "self_test": [asdict(each) for each in checks]},
            failure=f"this installation does not work: {'; '.join(wrong)}" if wrong else None,
        )


def _facts() -> dict[str, Any]:
    """The machine and the installation, in figures."""
    from importlib.metadata import version

    from polhode.cli import machine
    from polhode.code_cache import code_cache
    from polhode.optional_parts import PACKAGE
    from polhode.processes import worker_count

    usable_gib, free_gib = machine.memory_gib()
    cache = code_cache(PACKAGE / "lie.py")
    return {
        "version": version("polhode"),
        "installed_in": PACKAGE,
        "python": machine.python(),
        "wrong_packages": machine.wrong_packages(),
        "processors": machine.processors(),
        "workers": worker_count(0),
        "threads_per_process": 1,
        "memory_gib": usable_gib,
        "free_memory_gib": free_gib,
        "scratch_folder": machine.scratch_folder(),
        "free_scratch_gib": machine.scratch_gib(),
        "code_cache": cache,
    }


def _parts() -> list[dict[str, Any]]:
    """The optional parts, and what is missing of each."""
    from polhode.optional_parts import OPTIONAL_PARTS

    return [
        {
            "extra": part.extra,
            "packages": list(part.modules.values()),
            "missing": part.missing,
            "purpose": part.purpose,
            "install": part.how_to_install,
        }
        for part in OPTIONAL_PARTS
    ]


def _lines_of_facts(facts: Mapping[str, Any]) -> list[str]:
    packages = "; ".join(facts["wrong_packages"]) or "all that polhode needs, in versions that it accepts"
    usable_gib, free_gib = facts["memory_gib"], facts["free_memory_gib"]
    memory = "unknown" if usable_gib is None else f"{usable_gib:.1f} GiB"
    if free_gib is not None:
        memory += f", {free_gib:.1f} GiB of it free"
        if free_gib < LITTLE_MEMORY_GIB:
            memory += ": little for a run; close other programs, or use fewer --runtime.workers"
    cache = facts["code_cache"] or "none: functions are compiled in every run; set NUMBA_CACHE_DIR"
    return [
        f"polhode {facts['version']} in {facts['installed_in']}",
        f"Python         {facts['python']}",
        f"packages       {packages}",
        f"processors     {facts['processors']}: as many parallel processes (--runtime.workers), with "
        f"{facts['threads_per_process']} thread each (--runtime.blas-threads)",
        f"memory         {memory}",
        f"scratch space  {facts['free_scratch_gib']:.1f} GiB free in {facts['scratch_folder']}",
        f"code cache     {cache}",
    ]


def _lines_of_parts(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = ["", "Optional parts, none of which is needed:"]
    for part in parts:
        names = ", ".join(part["packages"])
        state = (
            f"missing: {', '.join(part['missing'])}; {part['install']}" if part["missing"] else "installed"
        )
        lines += [f"  {names} ({state})", f"      for {part['purpose']}"]
    return lines


def _lines_of_checks(checks: "Sequence[Check]") -> list[str]:
    if not checks:
        return []
    return [
        "",
        "Self-test:",
        *(
            f"  {'ok  ' if each.holds else 'FAIL'} {each.name:12s} {each.seconds:4.1f} s  {each.finding}"
            for each in checks
        ),
    ]
