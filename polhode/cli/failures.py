"""Errors that no room has explained, as exit code and one line: whose fault it is, where, and what to do."""

import errno
import os
import traceback

from polhode.runtime.errors import InputError, RunFailure, one_line, printable

EXHAUSTED = {
    errno.ENOSPC: "free some space, or choose an output on another disk",
    errno.EDQUOT: "free some space, or choose an output on another disk",
    errno.EFBIG: "raise the limit (ulimit -f), or choose an output on another file system",
    errno.EMFILE: "raise the limit (ulimit -n){or_one_worker}",
    errno.ENFILE: "close other programs{or_one_worker}",
    errno.EAGAIN: "raise the limit of processes (ulimit -u){or_one_worker}",
    errno.EIO: "the device fails: check it, and keep data and results on another",
    errno.ENOSYS: "the system lacks what is needed: see whether /dev/shm and /proc are there",
}
"""What the machine has run out of: it ends a command whatever its input is."""
REFUSED = {
    errno.EACCES: "change its permissions, or choose another path",
    errno.EPERM: "change its permissions, or choose another path",
    errno.EROFS: "choose a path on a file system that can be written",
    errno.ENAMETOOLONG: "choose shorter names",
    errno.ENOENT: "check the path, and that nothing else removes it meanwhile",
    errno.ENOTDIR: "check the path: a part of it is a file",
    errno.EISDIR: "give a file instead of a folder",
    errno.ENOTEMPTY: "choose another path, or empty the folder",
    errno.EEXIST: "choose another path, or remove what is there",
    errno.ELOOP: "a link leads back to itself: remove it",
}
"""What a path does not allow: the user's mistake, unless it comes amid the work."""
OUT_OF_MEMORY = ("can't allocate memory", "cannot allocate memory", "out of memory", "bad_alloc",
                 "insufficient memory", "failed to map segment")  # fmt: skip
"""What libraries say instead of raising MemoryError."""
LESS_MEMORY = {
    "predict": "use a larger --step-s or a smaller --horizon",
    "export": "use a larger --step-s or a smaller --horizon, or fewer --pieces",
    "plan": "use fewer --members or a smaller --horizon",
    "observability": "use fewer poses or a lighter mesh",
    **dict.fromkeys(
        ("simulate", "run", "compare", "train"),
        "use fewer --runtime.workers, fewer frames or smaller images",
    ),
}
"""How each command takes less of it, where its options can."""
NO_THREADS = ("can't start new thread", "can't start new process", "resource temporarily unavailable")


def explained(error: Exception, working: bool, command: str = "") -> tuple[int, str]:
    """Exit code and line of an error of a command; ``working``: it had finished a stage of its work."""
    if isinstance(error, InputError | RunFailure):
        return error.exit_code, one_line(str(error))
    code, line = _explained(error, working, command)
    # a room's notes say where results are
    return code, one_line("; ".join([line, *getattr(error, "__notes__", ())]))


def _explained(error: Exception, working: bool, command: str) -> tuple[int, str]:
    failed = RunFailure.exit_code
    users = failed if working else InputError.exit_code
    text = f"{error} {error.__context__ or ''}".lower()
    said = str(error).strip().partition("\n")[0][:120] or type(error).__name__
    less_memory = LESS_MEMORY.get(command, "close other programs")
    one_worker = ", or use --runtime.workers 1" if "workers" in less_memory else ""
    if isinstance(error, MemoryError) or any(words in text for words in OUT_OF_MEMORY):
        return failed, f"the memory is exhausted ({said}): {less_memory}, or raise the limit (ulimit -v)"
    if isinstance(error, RuntimeError) and any(words in text for words in NO_THREADS):
        remedy = f"raise the limits of processes (ulimit -u) and memory (ulimit -v){one_worker}"
        return failed, f"no more threads can be started ({said}): {remedy}"
    if isinstance(error, OSError) and error.errno is not None:
        names = (error.filename, error.filename2)
        files = [os.fsdecode(name) for name in names if isinstance(name, str | bytes)]
        where = f"{' -> '.join(files) or 'a file or process'}: {error.strerror or error}"
        if error.errno in EXHAUSTED:
            return failed, f"{where}: {EXHAUSTED[error.errno].format(or_one_worker=one_worker)}"
        return users, f"{where}: {REFUSED.get(error.errno, 'check this path and the device it is on')}"
    if isinstance(error, RecursionError) and not working:
        return users, "an input is nested too deeply to be read: flatten its lists and mappings"
    if isinstance(error, UnicodeDecodeError):
        where = f"byte 0x{error.object[error.start]:02x} at position {error.start}"
        return users, f"a text is not {error.encoding.upper()} ({where}): save the file as UTF-8"
    if isinstance(error, UnicodeEncodeError):
        name = error.object[max(error.start - 40, 0) : error.end + 20]
        return users, f"'{name}' cannot be written as {error.encoding.upper()}: choose another name"
    if isinstance(error, ImportError) or "shared object" in text:
        return failed, f"the installation is incomplete ({error}): install polhode again"
    defect = f"unexpected {type(error).__name__}: {error}; this is a defect of polhode; --debug shows where"
    return failed, defect


def printable_traceback(error: BaseException) -> str:
    """The traceback without control characters."""
    lines = "".join(traceback.format_exception(error)).splitlines()
    return "".join(printable(line) + "\n" for line in lines)
