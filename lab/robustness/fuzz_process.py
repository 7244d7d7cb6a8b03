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

from lab.robustness.fuzz_check import LIMIT_BYTES, Checker, Finding
from lab.robustness.fuzz_mutation import mutated
from lab.robustness.fuzz_targets import Target, target_named
from polhode.runtime.threads import limit_threads

MAX_INPUT_BYTES = 1 << 20
MAX_FINDINGS = 50
INSTRUMENTED = ("polhode", "PIL", "yaml", "trimesh.exchange", "zipfile", "numpy.lib._format_impl")
"""Modules whose branches guide the search, with those below them"""


class _Session:
    """Counts inputs and keeps findings."""

    def __init__(self, target: Target, folder: Path) -> None:
        self.folder = folder
        work = folder / "work"
        work.mkdir(parents=True)
        self.checker = Checker(target, work)
        self.start, self.written = time.monotonic(), 0.0
        self.inputs, self.places = 0, set[str]()

    def try_input(self, content: bytes) -> bool:
        """Feed one input; True when it was no finding."""
        found = self.checker(content)
        self.inputs += 1
        if found is not None:
            self.keep(content, found)
        if time.monotonic() - self.written > 1.0:
            if (changed := self.checker.changed_folder()) is not None:
                self.keep(content, changed)
            self.write_state()
        return found is None

    def keep(self, content: bytes, found: Finding) -> None:
        """Store the first input of each place."""
        if found.place not in self.places and len(self.places) < MAX_FINDINGS:
            self.places.add(found.place)
            store_finding(self.folder, content, found)
            self.write_state()

    def write_state(self) -> None:
        """Write state.json."""
        self.written = time.monotonic()
        state = {"inputs": self.inputs, "seconds": round(self.written - self.start, 1)}
        draft = self.folder / "state.draft"
        draft.write_text(json.dumps(state))
        draft.replace(self.folder / "state.json")


def store_finding(folder: Path, content: bytes, found: Finding) -> None:
    """An input with what it led to, under a name made from the place."""
    name = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in found.place)[:100]
    findings = folder / "findings"
    findings.mkdir(exist_ok=True)
    (findings / name).write_bytes(content)
    text = f"{found.place}\n\n{found.details}\n"
    (findings / f"{name}.txt").write_text(text, encoding="utf-8", errors="backslashreplace")


def from_words() -> None:
    """Run until the time is over; command line: target, folder, seconds, engine, seed."""
    target, folder = target_named(sys.argv[1]), Path(sys.argv[2])
    seconds, engine, seed = float(sys.argv[3]), sys.argv[4], int(sys.argv[5])
    limit_threads(1)
    seeds = target.seeds()
    session = _Session(target, folder)
    for found in session.checker.warm_up(seeds):
        session.keep(b"", found)
    _limit_memory()
    session.start = time.monotonic()
    session.write_state()
    if engine == "atheris":
        _fuzz_with_atheris(session, target, seeds, seconds, seed)
    else:
        _fuzz_with_own_mutator(session, target, seeds, seconds, seed)
    session.write_state()


def _limit_memory() -> None:
    """Address space: what is used now and the limit."""
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        limit = pages * resource.getpagesize() + LIMIT_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _fuzz_with_atheris(
    session: _Session, target: Target, seeds: list[bytes], seconds: float, seed: int
) -> None:
    import atheris

    for name, module in list(sys.modules.items()):
        if name.startswith(INSTRUMENTED):
            for value in list(vars(module).values()):
                if type(value) is FunctionType and value.__module__ == name:
                    atheris.instrument_func(value)
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
    atheris.Setup(words, lambda content: session.try_input(content) and None, custom_mutator=mutate)
    atheris.Fuzz()


def _fuzz_with_own_mutator(
    session: _Session, target: Target, seeds: list[bytes], seconds: float, seed: int
) -> None:
    rng = Random(seed)  # noqa: S311
    recent: deque[bytes] = deque(seeds, maxlen=200)
    while time.monotonic() - session.start < seconds:
        source = rng.choice(seeds) if rng.random() < 0.6 else rng.choice(recent)
        content = mutated(target, source, rng)[:MAX_INPUT_BYTES]
        if session.try_input(content) and rng.random() < 0.1:
            recent.append(content)
