"""``polhode doctor``: whether this installation works, on this machine."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from polhode.cli.answer import Answer
from polhode.cli.options import Command
from polhode.runtime.console import announce, choose_progress

if TYPE_CHECKING:
    from polhode.cli.self_test import Check
    from polhode.runtime.optional_parts import OptionalPart


class DoctorCommand(Command):
    """Check the installation: packages, load, memory, optional parts, and a self-test of some seconds.

    Exit code 0: it works; 1: something that polhode needs is missing or does not work. Optional parts are
    listed with what they are for and the command that adds them; none of them is needed. The first call after
    an installation takes longer, because functions are compiled.
    """

    skip_test: bool = False
    """Leave out the self-test."""

    def execute(self) -> Answer:
        """Look, test, and say what was found, each as soon as it is."""
        from polhode.runtime.optional_parts import OPTIONAL_PARTS

        facts: dict[str, Any] = {}
        for found, line in _facts():
            facts |= found
            announce(line)
        announce("")
        announce("Optional parts, none of which is needed:")
        parts = [_describe_part(part) for part in OPTIONAL_PARTS]
        checks = [] if self.skip_test else _run_self_test()
        wrong = [
            *facts["wrong_packages"],
            *(f"{each.name}: {each.finding}" for each in checks if not each.holds),
        ]
        works = "what polhode needs is installed" if self.skip_test else "polhode works here"
        return Answer(
            f"doctor: {len(wrong)} faults" if wrong else f"doctor: {works}",
            figures={**facts, "optional_parts": parts, "self_test": [asdict(each) for each in checks]},
            failure=f"this installation does not work: {'; '.join(wrong)}" if wrong else None,
        )


def _facts() -> Iterator[tuple[dict[str, Any], str]]:
    """The machine and the installation: figures, and a line about them, one after the other."""
    from importlib.metadata import version

    from polhode.cli import machine
    from polhode.runtime.code_cache import code_cache
    from polhode.runtime.optional_parts import PACKAGE
    from polhode.runtime.processes import worker_count

    own = version("polhode")
    yield {"version": own, "installed_in": PACKAGE}, f"polhode {own} in {PACKAGE}"
    yield {"python": machine.python()}, f"Python         {machine.python()}"
    wrong = machine.wrong_packages()
    packages = "; ".join(wrong) or "all that polhode needs, in versions that it accepts"
    yield {"wrong_packages": wrong}, f"packages       {packages}"
    processors = machine.processors()
    yield (
        {"processors": processors, "workers": worker_count(0), "threads_per_process": 1},
        f"processors     {processors}: as many parallel processes (--runtime.workers), with 1 thread each "
        "(--runtime.blas-threads)",
    )
    load = machine.load_average()
    yield {"load_average": load}, f"load           {_load_in_words(load, processors)}"
    usable_gib, free_gib = machine.memory_gib()
    yield (
        {"memory_gib": usable_gib, "free_memory_gib": free_gib},
        f"memory         {_memory_in_words(usable_gib, free_gib)}",
    )
    folder, scratch_gib = machine.scratch_folder(), machine.scratch_gib()
    yield (
        {"scratch_folder": folder, "free_scratch_gib": scratch_gib},
        f"scratch space  {scratch_gib:.1f} GiB free in {folder}",
    )
    cache = code_cache(PACKAGE / "lie.py")
    kept = cache or "none: functions are compiled in every run; set NUMBA_CACHE_DIR"
    yield {"code_cache": cache}, f"code cache     {kept}"


def _load_in_words(load: float | None, processors: int) -> str:
    """Load average beside the processors, and what it means for times."""
    if load is None:
        return "unknown"
    text = f"{load:.1f} processes on average over the last minute, on {processors} processors"
    if load < 0.5 * processors:
        return text
    slower = (load + processors) / processors
    return f"{text}: busy; a run takes up to {slower:.1f} times as long as on an idle machine"


def _memory_in_words(usable_gib: float | None, free_gib: float | None) -> str:
    memory = "unknown" if usable_gib is None else f"{usable_gib:.1f} GiB"
    if free_gib is not None:
        memory += f", {free_gib:.1f} GiB of it free"
        # a run of the sample takes some 1.3 GiB in all its processes
        if free_gib < 2.0:
            memory += ": little for a run; close other programs, or use fewer --runtime.workers"
    return memory


def _describe_part(part: "OptionalPart") -> dict[str, Any]:
    """An optional part and what is missing of it, which is also printed."""
    found: Mapping[str, Any] = {
        "extra": part.extra,
        "packages": list(part.modules.values()),
        "missing": part.missing,
        "purpose": part.purpose,
        "install": part.how_to_install,
    }
    lacks = f"missing: {', '.join(found['missing'])}; {part.how_to_install}"
    announce(f"  {', '.join(found['packages'])} ({lacks if found['missing'] else 'installed'})")
    announce(f"      for {part.purpose}")
    return dict(found)


def _run_self_test() -> "list[Check]":
    """The self-test, each check printed when it is done."""
    from polhode.cli.self_test import self_test

    announce("")
    announce("Self-test:")
    checks = []
    for each in self_test(choose_progress()):
        state = "ok  " if each.holds else "FAIL"
        announce(f"  {state} {each.name:12s} {each.seconds:4.1f} s  {each.finding}")
        checks.append(each)
    return checks
