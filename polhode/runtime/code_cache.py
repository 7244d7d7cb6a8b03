"""Where compiled code is kept between runs: only in folders into which no other user can put any.

What lies in such a folder is executed. On a machine with several users, a cache in a place where others may
write would run their code with the rights of whoever reads it.
"""

import logging
import math
import multiprocessing
import os
import stat
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from polhode.runtime.errors import InputError

_log = logging.getLogger(__name__)


def require_no_settings_of_numba() -> None:
    """Raise InputError if numba would read settings from the current folder, which may be another's, or if
    the environment has a variable with which it does not work.

    Settings decide how numbers are computed, and from where compiled code is loaded.
    """
    settings = Path(".numba_config.yaml")
    if settings.exists():
        raise InputError(
            f"{settings} in the current folder has settings of numba, which would change the results: "
            "start polhode in another folder, or remove it"
        )
    for name, least, most, reason in (
        ("NUMBA_DISABLE_JIT", 0, 0, "without compiled functions polhode cannot work"),
        ("NUMBA_NUM_THREADS", 1, math.inf, "numba needs one thread at least"),
    ):
        value = os.environ.get(name, "")
        # numba, too, takes no notice of what is no number
        with suppress(ValueError):
            if not least <= int(value) <= most:
                raise InputError(f"{name}={value} in the environment: {reason}; unset it")


def code_cache(source: Path) -> Path | None:
    """The folder for the compiled functions of a module's file; None: nothing is to be kept.

    The folder of NUMBA_CACHE_DIR, if that is set; else ``__pycache__`` beside the module, from which Python
    itself takes code, if it can be written; else ``polhode`` in the user's own folder of caches. A folder
    that others may write to is not used: where NUMBA_CACHE_DIR names one, nothing is kept.
    """
    if not source.is_file():
        return None
    return _folder(source.parent.absolute(), os.environ.get("NUMBA_CACHE_DIR", ""))


@cache
def _folder(package: Path, given: str) -> Path | None:
    if given:
        if is_private(Path(given)) and _writable(Path(given)):
            return Path(given).absolute()
        _say_once(f"NUMBA_CACHE_DIR={given} is not used: others may write there, or you may not")
        return None
    beside = package / "__pycache__"
    if _writable(beside) and _guarded_as(beside.stat(), package.stat()):
        return beside
    base = os.environ.get("XDG_CACHE_HOME", "")
    with suppress(RuntimeError):
        # a relative one is to be ignored (XDG Base Directory Specification)
        own = (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "polhode"
        if is_private(own) and _writable(own):
            return own
    _say_once("compiled code is not kept, as no folder for it is writable by you alone: set NUMBA_CACHE_DIR")
    return None


def is_private(folder: Path) -> bool:
    """Whether only this user and root can put files there, or put another folder in its place.

    A folder that is missing is made, with access for this user alone.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        inner, *outer = (path.stat() for path in (folder.resolve(), *folder.resolve().parents))
    except OSError:
        return False
    trusted = (0, os.geteuid())
    if inner.st_uid not in trusted or inner.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return False
    # in a sticky folder, as /tmp, only its owner can rename or remove an entry
    return all(
        each.st_uid in trusted and (not each.st_mode & stat.S_IWOTH or each.st_mode & stat.S_ISVTX)
        for each in outer
    )


def _guarded_as(inner: os.stat_result, package: os.stat_result) -> bool:
    """Whether whoever can write to the folder is this user or can write to the package anyway."""
    if (inner.st_mode | package.st_mode) & stat.S_IWOTH:
        return False
    is_same_group = package.st_mode & stat.S_IWGRP and inner.st_gid == package.st_gid
    if inner.st_mode & stat.S_IWGRP and not is_same_group:
        return False
    return inner.st_uid in (0, os.geteuid(), package.st_uid)


def _writable(folder: Path) -> bool:
    """Whether a file can be made there, as numba itself tries."""
    try:
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@cache
def _say_once(what: str) -> None:
    if multiprocessing.parent_process() is None:
        _log.warning("%s; functions are compiled in every run, which takes a minute", what)
