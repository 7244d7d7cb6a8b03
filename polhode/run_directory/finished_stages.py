"""Results of finished stages, kept in RUN/stages, so that a run that was interrupted goes on from them.

A stage is a function of its inputs. Its result is stored under a key, the digest of all that determines it:
the name of the stage, its inputs, the program and its libraries. Whoever asks for a result gets the stored
one if the key is there, and else computes and stores it. So nothing has to be known of what a change of the
configuration or of the data affects: what still has the same inputs has the same key.

A result is passed on as it would be read (``record_files.normal``), whether it was computed or read: a run
that was interrupted and one that was not compute with the same digits.

    stages/recording.json          the recording that the results are of
    stages/STAGE/KEY.npz           results that this run has used
    stages/earlier/STAGE/KEY.npz   results of an earlier run that this one has not asked for yet; one that is
                                   used moves up, and the others are removed when the run is complete
"""

import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from pydantic import ValidationError

from polhode.files.atomic import write_text
from polhode.files.foreign_files import CONFIGURATION_BYTES, amount, read_bytes
from polhode.files.output.run_files import STAGES, is_stage_file
from polhode.files.record_files import digest_of, normal, read_record, write_record
from polhode.run_directory.recording import require_recording
from polhode.run_directory.summary_schema import Recording
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.program_digest import program_digest
from polhode.runtime.progress import NOTE

T = TypeVar("T")

EARLIER, RECORDING = "earlier", "recording.json"
DEPTH = "depth"
"""The stage with the depth map of each pair"""

_log = logging.getLogger(__name__)


@dataclass
class StageStore:
    """Results by stage and key, in a folder; without one, every result is computed."""

    folder: Path | None = None
    """RUN/stages"""
    salt: str = ""
    """What all keys depend on besides the inputs and the program"""
    only: str | None = None
    """The stage whose results are stored; None: all"""
    found: int = 0
    """Results that were stored already, so far"""
    stored: int = 0
    bytes: int = 0
    """Of the results that this run has stored"""

    def each(
        self,
        stage: str,
        kind: type[T],
        keys: Sequence[str],
        compute: Callable[[list[int]], Iterable[T]],
        max_bytes: float = np.inf,
    ) -> Iterator[T]:
        """The results of these keys, in order, each stored as soon as it is there.

        compute: the results of those with these indices, in order; max_bytes: of those that are stored.
        """
        missing = [k for k, key in enumerate(keys) if not self.has(stage, key)]
        computed = iter(compute(missing)) if missing else iter(())
        waiting, stored_bytes = set(missing), 0
        for k, key in enumerate(keys):
            result = None if k in waiting else self.find(stage, key, kind)
            if result is None:
                source = computed if k in waiting else iter(compute([k]))
                result = normal(kind, next(source))
                if stored_bytes < max_bytes:
                    stored_bytes += self.put(stage, key, result)
            yield result

    def key(self, *inputs: object) -> str:
        """The key of the result of these inputs. Raises UnfitRecord for one of which no digest is known."""
        if self.folder is None:
            return ""
        return digest_of(self.salt, program_digest(), inputs)[:32]

    def _file(self, stage: str, key: str) -> Path | None:
        is_stored = self.only is None or stage == self.only
        return self.folder / stage / f"{key}.npz" if self.folder is not None and is_stored else None

    def has(self, stage: str, key: str) -> bool:
        """Whether a result is stored; one of an earlier run is now of this one."""
        file = self._file(stage, key)
        if file is None or self.folder is None:
            return False
        if not file.is_file():
            earlier = self.folder / EARLIER / stage / file.name
            if not earlier.is_file():
                return False
            file.parent.mkdir(exist_ok=True)
            earlier.rename(file)
        return True

    def find(self, stage: str, key: str, kind: type[T]) -> T | None:
        """The stored result; None: there is none, or it is damaged."""
        file = self._file(stage, key)
        if file is None or not file.is_file():
            return None
        result = read_record(file, f"{stage} {key}", kind)
        if result is None:
            _log.warning("%s: damaged, so this result is computed again", file)
        else:
            self.found += 1
        return result

    def put(self, stage: str, key: str, result: object) -> int:
        """Store a result; returns the size of its file [bytes], 0 where nothing is kept."""
        file, size = self._file(stage, key), 0
        if file is None:
            return size
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_record(file, f"{stage} {key}", result)
            size = file.stat().st_size
            self.stored += 1
            self.bytes += size
        except (OSError, RunFailure) as error:
            # the room is for the results
            _log.warning("stages are not kept, so that --resume will have nothing to go on from: %s", error)
            self.clear()
            self.folder = None
        return size

    def clear(self) -> None:
        """Remove all results."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


@dataclass
class KeptStages:
    """The folder of the stages of a run: what it takes over from earlier ones, and what it leaves."""

    folder: Path
    """RUN/stages, where RUN is still hidden"""
    published: Path
    """RUN"""
    resume: bool
    store: StageStore = field(default_factory=StageStore)
    keeping: Literal["kept", "while_running", "none"] = "kept"

    def take_over(self) -> None:
        """What an interrupted run has left counts as earlier."""
        for path in sorted(self.folder.iterdir()) if self.folder.is_dir() else ():
            if path.name != EARLIER:
                _merge(path, self.folder / EARLIER / path.name)

    def open(
        self,
        recording: Recording,
        before: Recording | None,
        sequence_folder: Path,
        keeping: Literal["kept", "while_running", "none"],
        salt: str,
    ) -> StageStore:
        """The store for the run of a sequence; with ``resume`` it has what earlier runs have left.

        before: the recording of the run that is published. Raises InputError: all that is there to resume is
        of another recording.
        """
        self.keeping = keeping
        if self.resume:
            earlier, refusals = self.folder / EARLIER, dict[Path, InputError]()
            sources = {earlier: _read_recording(earlier / RECORDING), self.published: before}
            for source, known in sources.items():
                try:
                    require_recording(
                        known, sequence_folder, "give --data of the same recording, or another -o"
                    )
                except InputError as error:
                    refusals[source] = error
            if refusals and not any(known and source not in refusals for source, known in sources.items()):
                raise next(iter(refusals.values()))
            if earlier in refusals:
                shutil.rmtree(earlier)
            if self.published not in refusals:
                _link_all(self.published / STAGES, earlier)
            if number := sum(name.endswith(".npz") for name in _names(earlier)):
                _log.log(NOTE, "resuming: %d results of stages are there", number)
            else:
                _log.log(NOTE, "there is nothing to resume: all is computed")
        self.store = StageStore(self.folder, salt)
        if keeping == "none":
            # depth maps may be more than the memory holds; they go with the run
            self.store.clear()
            self.store = StageStore(self.folder, salt, DEPTH)
        with suppress(OSError, RunFailure):
            self.folder.mkdir(exist_ok=True)
            write_text(self.folder / RECORDING, recording.model_dump_json())
        return self.store

    @property
    def has_results(self) -> bool:
        """Whether an interrupted run can go on from here."""
        return self.keeping != "none" and any(name.endswith(".npz") for name in _names(self.folder))

    def finish(self) -> None:
        """The run is complete: what it has not used goes, or everything, if nothing is to be kept."""
        if self.store.found or self.store.stored:
            _log.info(
                "results of stages: %d were there, %d stored (%s)",
                *(self.store.found, self.store.stored, amount(self.store.bytes)),
            )
        shutil.rmtree(self.folder if self.keeping != "kept" else self.folder / EARLIER, ignore_errors=True)


def _read_recording(path: Path) -> Recording | None:
    """The recording that stored results are of; None: it is not known."""
    try:
        return Recording.model_validate_json(read_bytes(path, CONFIGURATION_BYTES, "a recording"))
    except (InputError, ValidationError):
        return None


def _names(folder: Path) -> list[str]:
    """Of the files below a folder, relative to it."""
    return [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]


def _merge(source: Path, destination: Path) -> None:
    """Move a file, or the files of a folder, where there may be some already."""
    if source.is_dir():
        for path in sorted(source.iterdir()):
            _merge(path, destination / path.name)
        with suppress(OSError):
            source.rmdir()
    else:
        destination.parent.mkdir(parents=True, exist_ok=True)
        source.replace(destination)


def _link_all(source: Path, destination: Path) -> None:
    """Make the results of a published run appear here as well: as links, or else as copies."""
    for name in _names(source) if source.is_dir() else ():
        new = destination / name
        if is_stage_file(f"{STAGES}/{name}") and not new.exists() and not (source / name).is_symlink():
            new.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(source / name, new)
            except OSError:
                shutil.copy2(source / name, new)
