"""The process of one target: reads its corpus, then inputs that an engine makes, until its time is over.

Started by ``fuzzing`` (``from_words``). Coverage of branches guides Atheris; without it a mutator of our own
draws on earlier inputs. FOLDER receives ``findings/`` (an input and its traceback for each place) and
``state.json``, written every second; the input in work is in ``work/``, where the parent finds it if this
process dies or hangs.
"""

import json
import resource
import sys
import time
from collections import deque
from pathlib import Path
from random import Random
from types import FunctionType

from benchmarks.robustness.fuzz_check import LIMIT_BYTES, Checker, Finding
from benchmarks.robustness.fuzz_mutation import mutated
from benchmarks.robustness.fuzz_targets import SHARED_MODULES, Target, target_named
from polhode.threads import limit_threads

MAX_INPUT_BYTES = 1 << 20
MAX_FINDINGS = 50
WARM_UP = "warm-up"


class _Session:
    """Counts inputs and keeps findings."""

    def __init__(self, target: Target, folder: Path) -> None:
        self.folder = folder
        work = folder / "work"
        work.mkdir(parents=True)
        self.checker = Checker(target, work)
        self.start, self.written = time.monotonic(), 0.0
        self.inputs, self.places = 0, set[str]()

    def one(self, content: bytes) -> bool:
        """Feed one input; True when it was no finding."""
        found = self.checker(content)
        self.inputs += 1
        if found is not None:
            self.keep(content, found)
        if time.monotonic() - self.written > 1.0:
            if (changed := self.checker.changed_folder()) is not None:
                self.keep(content, changed)
            self.note()
        return found is None

    def keep(self, content: bytes, found: Finding) -> None:
        """Store the first input of each place."""
        if found.place in self.places or len(self.places) >= MAX_FINDINGS:
            return
        self.places.add(found.place)
        store_finding(self.folder, content, found)
        self.note()

    def note(self) -> None:
        """Write state.json."""
        self.written = time.monotonic()
        state = {"inputs": self.inputs, "seconds": round(self.written - self.start, 1)}
        draft = self.folder / "state.draft"
        draft.write_text(json.dumps(state))
        draft.replace(self.folder / "state.json")


def store_finding(folder: Path, content: bytes, found: Finding) -> None:
    """An input with what it led to, under a name made from the place."""
    name = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in found.place)[:100]
    kept = folder / "findings"
    kept.mkdir(exist_ok=True)
    (kept / name).write_bytes(content)
    (kept / f"{name}.txt").write_text(
        f"{found.place}\n\n{found.details}\n", encoding="utf-8", errors="backslashreplace"
    )


def main(name: str, folder: Path, seconds: float, engine: str, seed: int) -> None:
    """Run until the time is over."""
    limit_threads(1)
    target = target_named(name)
    seeds = target.seeds()
    session = _Session(target, folder)
    for found in session.checker.warm_up(seeds):
        session.keep(b"", found)
    _limit_memory()
    session.start = time.monotonic()
    session.note()
    if engine == "atheris":
        _with_atheris(session, target, seeds, seconds, seed)
    else:
        _without(session, target, seeds, seconds, seed)
    session.note()


def _instrument(target: Target) -> None:
    """Let Atheris see the branches of the functions that have been imported from the target's modules."""
    import atheris

    for name, module in list(sys.modules.items()):
        if not any(
            name == each or name.startswith(f"{each}.") for each in (*SHARED_MODULES, *target.modules)
        ):
            continue
        for owner in (module, *(each for each in vars(module).values() if issubclass(type(each), type))):
            if owner is not module and owner.__module__ != name:
                continue
            for value in list(vars(owner).values()):
                function = value.__func__ if type(value) in (staticmethod, classmethod) else value
                # Placeholders of missing packages raise at any look into them.
                if type(function) is FunctionType and function.__module__ == name:
                    atheris.instrument_func(function)


def _limit_memory() -> None:
    """Address space: what is used now and the limit."""
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        limit = pages * resource.getpagesize() + LIMIT_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _with_atheris(session: _Session, target: Target, seeds: list[bytes], seconds: float, seed: int) -> None:
    import atheris

    _instrument(target)
    corpus = session.folder / "corpus"
    corpus.mkdir(exist_ok=True)
    for number, content in enumerate(seeds):
        (corpus / f"seed{number}").write_bytes(content)

    def mutate(content: bytes, max_size: int, number: int) -> bytes:
        rng = Random(number)  # noqa: S311
        changed = mutated(target, content, rng) if rng.random() < 0.7 else atheris.Mutate(content, max_size)
        return bytes(changed[:max_size])

    words = [
        *("fuzz", str(corpus), f"-max_total_time={max(1, int(seconds))}", f"-max_len={MAX_INPUT_BYTES}"),
        *(f"-seed={seed + 1}", "-timeout=100000", "-rss_limit_mb=0", "-handle_segv=0", "-handle_abrt=0"),
    ]
    atheris.Setup(words, lambda content: session.one(content) and None, custom_mutator=mutate)
    atheris.Fuzz()


def _without(session: _Session, target: Target, seeds: list[bytes], seconds: float, seed: int) -> None:
    rng = Random(seed)  # noqa: S311
    recent: deque[bytes] = deque(seeds, maxlen=200)
    while time.monotonic() - session.start < seconds:
        source = rng.choice(seeds) if rng.random() < 0.6 else rng.choice(recent)
        content = mutated(target, source, rng)[:MAX_INPUT_BYTES]
        if session.one(content) and rng.random() < 0.1:
            recent.append(content)


def from_words() -> None:
    """``main`` with the words of the command line: target, folder, seconds, engine, seed."""
    main(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]), sys.argv[4], int(sys.argv[5]))
