"""``polhode doctor``: whether this installation works, on this machine."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from polhode.cli.answer import Answer
from polhode.cli.options import Command
from polhode.runtime.console import announce, choose_progress


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
        for line in ("", "Optional parts, none of which is needed:"):
            announce(line)
        parts = []
        for part in OPTIONAL_PARTS:
            packages, missing = list(part.modules.values()), part.missing
            state = f"missing: {', '.join(missing)}; {part.how_to_install}" if missing else "installed"
            announce(f"  {', '.join(packages)} ({state})")
            announce(f"      for {part.purpose}")
            about = {"purpose": part.purpose, "install": part.how_to_install}
            parts.append({"extra": part.extra, "packages": packages, "missing": missing, **about})
        checks = []
        if not self.skip_test:
            from polhode.cli.self_test import self_test

            for line in ("", "Self-test:"):
                announce(line)
            for each in self_test(choose_progress()):
                state = "ok  " if each.holds else "FAIL"
                announce(f"  {state} {each.name:12s} {each.seconds:4.1f} s  {each.finding}")
                checks.append(each)
        failed = [f"{each.name}: {each.finding}" for each in checks if not each.holds]
        wrong = [*facts["wrong_packages"], *failed]
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
    load, text = machine.load_average(), "unknown"
    if load is not None:
        text = f"{load:.1f} processes on average over the last minute, on {processors} processors"
        if load >= 0.5 * processors:
            slower = (load + processors) / processors
            text += f": busy; a run takes up to {slower:.1f} times as long as on an idle machine"
    yield {"load_average": load}, f"load           {text}"
    usable_gib, free_gib = machine.memory_gib()
    text = "unknown" if usable_gib is None else f"{usable_gib:.1f} GiB"
    if free_gib is not None:
        text += f", {free_gib:.1f} GiB of it free"
        # a run of the sample takes some 1.3 GiB in all its processes
        if free_gib < 2.0:
            text += ": little for a run; close other programs, or use fewer --runtime.workers"
    yield {"memory_gib": usable_gib, "free_memory_gib": free_gib}, f"memory         {text}"
    folder, scratch_gib = machine.scratch()
    yield (
        {"scratch_folder": folder, "free_scratch_gib": scratch_gib},
        f"scratch space  {scratch_gib:.1f} GiB free in {folder}",
    )
    cache = code_cache(PACKAGE / "geometry" / "lie.py")
    kept = cache or "none: functions are compiled in every run; set NUMBA_CACHE_DIR"
    yield {"code_cache": cache}, f"code cache     {kept}"
