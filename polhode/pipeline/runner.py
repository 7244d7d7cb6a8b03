"""Runs the stages of a flow: what is computed again, and by which process, follows from their inputs.

A flow calls the runner with stages and with the results of others, in the order of the data; ``finish`` then
computes them. A result whose inputs and settings are those of an earlier run is read from its folder
(``run_directory.finished_stages``). This process works on the longest chain of results. Beside it, another
one takes the first of the others whose inputs are there, or else what is made pair by pair; what it has not
begun when this process has nothing else to do is done here.
"""

import logging
import logging.handlers
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial, update_wrapper
from operator import attrgetter
from pathlib import Path
from time import perf_counter
from types import SimpleNamespace
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, cast, get_type_hints

from polhode.config import Config
from polhode.files.record_files import digest_of, normal
from polhode.pipeline.context import RunContext
from polhode.runtime.processes import Background, log_without_processes, worker_killed
from polhode.runtime.progress import Silent

P = ParamSpec("P")
T = TypeVar("T")
Job = Callable[[RunContext], Any]


@dataclass
class Stopwatch:
    """Seconds spent under each name: ``with clock("fusion"): ...``, without those of a block within it."""

    seconds: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=perf_counter)
    _inner_s: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        begin, outer_s, self._inner_s = perf_counter(), self._inner_s, 0.0
        try:
            yield
        finally:
            took_s = perf_counter() - begin
            self.add(name, took_s - self._inner_s)
            self._inner_s = outer_s + took_s

    def add(self, name: str, seconds: float) -> None:
        """Add the seconds that another process took."""
        with self._lock:
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds

    def with_total(self) -> dict[str, float]:
        """The seconds by name; the total includes what has no name."""
        return {**self.seconds, "total": perf_counter() - self.start}


class Stage(Generic[P, T]):
    """A function from the context and records to a record, with what a run has to know of it (``stage``)."""

    def __init__(
        self,
        make: Callable[Concatenate[RunContext, P], T],
        clock: str,
        sees: Sequence[str],
        is_stored: bool,
        writes: bool,
    ) -> None:
        update_wrapper(self, make)
        self.make, self.clock, self.sees = make, clock, tuple(sees)
        self.is_stored, self.writes = is_stored, writes
        self.name = make.__name__
        """Of the function, and of the folder of stored results"""

    def __call__(self, context: RunContext, *inputs: P.args, **named: P.kwargs) -> T:
        """The result as a run passes it on: the same whether it is computed or read."""
        return self.normal(self.make(context, *inputs, **named))

    def __reduce__(self) -> str:
        return self.make.__qualname__

    @property
    def kind(self) -> type[T]:
        """Type of the result, from the annotation of the function."""
        return cast(type[T], get_type_hints(self.make)["return"])

    def normal(self, result: T) -> T:
        """The result in the form in which it would be read, if it is stored."""
        return normal(self.kind, result) if self.is_stored else result

    def settings(self, config: Config) -> list[tuple[str, Any]]:
        """The settings that the stage declares, by name."""
        return [(name, attrgetter(name)(config)) for name in self.sees]

    def seen(self, context: RunContext) -> RunContext:
        """The context without the settings that the stage does not declare."""
        config = SimpleNamespace(runtime=context.config.runtime)
        for name, value in self.settings(context.config):
            section, _, part = name.partition(".")
            if part and not part.startswith("for_"):
                vars(config).setdefault(section, SimpleNamespace())
                setattr(getattr(config, section), part, value)
            else:
                setattr(config, section, value)
        return replace(context, config=cast(Config, config))


def stage(
    clock: str, sees: Sequence[str] = (), is_stored: bool = True, writes: bool = False
) -> Callable[[Callable[Concatenate[RunContext, P], T]], Stage[P, T]]:
    """Declare a stage: ``clock`` is its entry of timing_s; it sees only these settings ("mapping.levels").

    ``is_stored``: the result is kept, to be used again; ``writes``: it is files of the run, which are
    written as soon as they can be, so that they stand should a later stage fail.
    """
    return lambda make: Stage(make, clock, sees, is_stored and not writes, writes)


class MadeByPair(Sequence[Any]):
    """A result that is complete when its items, one for each pair, have been asked for."""

    max_stored_bytes: int
    """Of all items"""

    @abstractmethod
    def jobs(self) -> Iterator[Job]:
        """What makes the missing items and stores them, each returning the bytes of its file."""


class _Counted(Sequence[Any]):
    """A result made by pair; the time until an item is there counts for the stage whose result it is."""

    def __init__(self, items: MadeByPair, clock: Callable[[], Any]) -> None:
        self.items, self.clock = items, clock

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, k: Any) -> Any:
        with self.clock():
            return self.items[k]

    def __iter__(self) -> Iterator[Any]:
        items = iter(self.items)
        for _ in range(len(self.items)):
            with self.clock():
                item = next(items)
            yield item


class Result(Generic[T]):
    """Of a stage in a run, there or not yet."""

    def __init__(
        self, made_by: Stage[..., T], inputs: Sequence[Any], key: str, found: T | None = None
    ) -> None:
        self.stage, self.inputs, self.key = made_by, inputs, key
        self.before = [each for each in inputs if isinstance(each, Result)]
        self.length: int = 1 + max((each.length for each in self.before), default=0)
        """Stages of the longest chain that ends here"""
        self.is_begun = self.is_done = found is not None
        self.is_used = self.is_complete = False
        """Whether this process has begun to ask for the items of a result made by pair, and has them all"""
        self.value = cast(T, found)
        """Once it is done"""

    @property
    def is_ready(self) -> bool:
        """Whether it can be computed."""
        return not self.is_begun and all(each.is_done for each in self.before)


class Runner:
    """Of one run: ``run(stage, inputs)`` is what will be the result of the stage, ``finish`` computes all."""

    def __init__(self, context: RunContext, clock: Stopwatch) -> None:
        self.context, self.clock = context, clock
        self._images = ""
        self._results: list[Result[Any]] = []
        self._here: set[Result[Any]] = set()
        self._changed = threading.Condition()
        self._failure: BaseException | None = None
        self._is_closed = False

    def __call__(self, made_by: Stage[..., T], *inputs: object) -> Result[T]:
        """What will be the result of a stage. inputs: results of others, records, or the run's folder."""
        store, key = self.context.stages, ""
        if store.folder is not None:
            self._images = self._images or digest_of(self.context.sequence, self.context.rectifier)
            settings = made_by.settings(self.context.config)
            weights = [each.with_digests[1] for _, each in settings if hasattr(each, "with_digests")]
            known = [each.key if isinstance(each, Result) else each for each in inputs]
            known = [each for each in known if not isinstance(each, Path)]
            key = store.key(made_by.name, settings, weights, self._images, known)
        is_there = made_by.is_stored and store.has(made_by.name, key)
        found = store.find(made_by.name, key, made_by.kind) if is_there else None
        result = Result(made_by, inputs, key, found)
        self._results.append(result)
        return result

    def parts(self, made_by: Stage[..., Any], *inputs: object) -> list[Result[Any]]:
        """The fields of a stage's result, which is computed now."""
        value, found = self.value(self(made_by, *inputs)), []
        for each in fields(value):
            part = getattr(value, each.name)
            key = digest_of(part) if self.context.stages.folder is not None else ""
            found.append(Result[Any](made_by, (), key, part))
        return found

    def value(self, result: Result[T]) -> T:
        """The result, which is computed here if it is not there yet."""
        if not result.is_done:
            result.is_begun = True
            inputs, made_by = [], result.stage
            for given in result.inputs:
                value = self.value(given) if isinstance(given, Result) else given
                if isinstance(value, MadeByPair):
                    # the time until an item of it is made is not this stage's
                    given.is_used, value = True, _Counted(value, partial(self.clock, given.stage.clock))
                inputs.append(value)
            with self.clock(made_by.clock):
                found = made_by(made_by.seen(self.context), *inputs)
            self._settle(result, found)
        return result.value

    def of_frames(self, frames: Any) -> None:
        """What follows is computed from some of the frames; all before must have been."""
        self.context, self._images = self.context.of_frames(frames), ""

    def finish(self) -> None:
        """Compute all results. Raises what a stage raises."""
        chain: list[Result[Any]] = self._results
        while chain:
            longest = max(chain, key=lambda each: each.length)
            self._here.add(longest)
            chain = longest.before
        # what is made by pair is but a list until its items are asked for
        light = (each for each in self._results if each.stage.writes or hasattr(each.stage.kind, "jobs"))
        self._here.update(light)
        with self._other_process():
            while (result := self._next_here(self._here)) is not None:
                self.value(result)
            left = {each for each in self._results if not each.is_begun}
            with self.context.progress.stage("checks and pictures", max(len(left), 1)) as advance:
                while (result := self._next_here(None)) is not None:
                    self.value(result)
                    advance()

    def _settle(self, result: Result[T], value: T) -> None:
        made_by = result.stage
        if made_by.is_stored:
            self.context.stages.put(made_by.name, result.key, value)
        with self._changed:
            result.value, result.is_done = value, True
            for each in result.before:
                each.is_complete = each.is_complete or each.is_used
            self._changed.notify_all()

    def _next_here(self, among: set[Result[Any]] | None) -> Result[Any] | None:
        """What this process does next; None: nothing is left. ``among``: of these, None if none is ready."""
        with self._changed:
            while True:
                ready = [each for each in self._results if each.is_ready]
                if self._failure is not None:
                    # what was found is written all the same
                    ready, among = [each for each in ready if each.stage.writes], None
                    if not ready:
                        raise self._failure
                ready.sort(key=lambda each: each not in self._here)
                if ready and (among is None or ready[0] in among):
                    ready[0].is_begun = True
                    return ready[0]
                if among is not None or all(each.is_done for each in self._results):
                    return None
                self._changed.wait()

    def _next_beside(self) -> Result[Any] | None:
        """What the other process does next: a result, or an item of one that is done; None: nothing."""
        with self._changed:
            while not (self._is_closed or self._failure or all(each.is_begun for each in self._results)):
                for each in self._results:
                    items = [one for one in each.before if isinstance(one.value, MadeByPair)]
                    if each.is_ready and each not in self._here and all(one.is_complete for one in items):
                        each.is_begun = True
                        return each
                wanted = [one for each in self._results if not each.is_begun for one in each.before]
                for each in wanted:
                    if each.is_done and isinstance(each.value, MadeByPair) and not each.is_used:
                        return each
                self._changed.wait()
        return None

    @contextmanager
    def _other_process(self) -> Iterator[None]:
        """Another process, and the thread of this one that passes work to it, until the block ends."""
        if self.context.workers == 1:
            yield
            return
        quiet = replace(self.context, progress=Silent())
        work = _Quietly(quiet, logging.getLogger("polhode").getEffectiveLevel())
        try:
            # what the run waits for goes first; the first job starts the process
            background: Background[Job, _Found] = Background(work, niceness=5)
            background.submit(_nothing)
        except OSError as error:
            log_without_processes(error)
            yield
            return
        thread = threading.Thread(target=self._work_beside, args=(background,), daemon=True)
        thread.start()
        is_complete = False
        try:
            yield
            is_complete = True
        finally:
            with self._changed:
                self._is_closed = True
                self._changed.notify_all()
            background.close(kill=not is_complete)
            thread.join()

    def _work_beside(self, background: "Background[Job, _Found]") -> None:
        items: Iterator[Job] | None = None
        stored_bytes = 0
        while (result := self._next_beside()) is not None:
            is_item = result.is_done
            try:
                if is_item:
                    items = result.value.jobs() if items is None else items
                    job = next(items, None) if stored_bytes < result.value.max_stored_bytes else None
                    if job is None:
                        result.is_used = True
                        continue
                else:
                    inputs = [each.value if isinstance(each, Result) else each for each in result.inputs]
                    job = partial(_make, result.stage, inputs)
                found = _result_of(background, job)
                self.clock.add(result.stage.clock, found.seconds)
                if is_item:
                    stored_bytes += found.value
                else:
                    self._settle(result, result.stage.normal(found.value))
            except BaseException as error:  # noqa: BLE001  raised where the result is waited for
                with self._changed:
                    if is_item:
                        # this process makes the item, and raises the error
                        result.is_used = True
                    else:
                        self._failure = error
                    self._changed.notify_all()


def _make(made_by: Stage[..., Any], inputs: Sequence[Any], context: RunContext) -> Any:
    return made_by.make(made_by.seen(context), *inputs)


def _nothing(context: RunContext) -> None:
    del context


@dataclass(frozen=True)
class _Found:
    """What the other process found."""

    value: Any
    seconds: float
    messages: list[logging.LogRecord]


class _Quietly(logging.handlers.QueueHandler):
    """Does jobs in the other process, whose messages are shown by this one."""

    def __init__(self, context: RunContext, level: int) -> None:
        super().__init__(queue=None)  # type: ignore[arg-type]
        self._context, self._level = context, level
        self._messages: list[logging.LogRecord] = []

    def __reduce__(self) -> Any:
        return _Quietly, (self._context, self._level)

    def __call__(self, job: Job) -> _Found:
        logger, self._messages, begin = logging.getLogger("polhode"), [], perf_counter()
        logger.setLevel(self._level)
        logger.handlers, logger.propagate = [self], False
        return _Found(job(self._context), perf_counter() - begin, self._messages)

    def enqueue(self, record: logging.LogRecord) -> None:
        """Keep a message, in a form that another process can show."""
        self._messages.append(record)


def _result_of(background: Background[Job, _Found], job: Job) -> _Found:
    """What a job gives, once it is done. Raises what it raises, and RunFailure if its process is killed."""
    try:
        future = background.submit(job)
        if future is None:
            raise worker_killed()
        found = future.result()
    except BrokenProcessPool:
        raise worker_killed() from None
    for message in found.messages:
        logging.getLogger(message.name).handle(message)
    return found
