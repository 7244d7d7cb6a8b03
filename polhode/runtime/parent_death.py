"""Processes that end with the one that started them, even if that is killed and whatever they are doing.

Linux sends the signal (``prctl``, PR_SET_PDEATHSIG) when the thread that started the process ends. Elsewhere
these functions change nothing. The server that forks the workers imports this module first: else it would
wait for its workers, which wait for it. The workers end with the server, even while they still import.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

PR_SET_PDEATHSIG = 1
PARENT = "POLHODE_PARENT"
"""Environment variable of the server: the number of the process that starts it in its main thread."""
_TIED = (
    "import ctypes, os, sys;"
    f"ctypes.CDLL(None).prctl({PR_SET_PDEATHSIG}, {int(signal.SIGKILL)});"
    "os.getppid() == int(sys.argv[1]) or sys.exit(1);"
    "os.execvp(sys.argv[2], sys.argv[2:])"
)


def end_with_parent(parent: int) -> None:
    """Kill this process when its parent ends; ``parent``: its number, lest it has ended already."""
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL))
    if os.getppid() != parent:
        os._exit(1)


def tied(command: Sequence[str]) -> list[str]:
    """The command, so that it is killed when the process that starts it ends, from its first moment on."""
    if not sys.platform.startswith("linux"):
        return list(command)
    return [sys.executable, "-I", "-S", "-c", _TIED, str(os.getpid()), *command]


if _parent := os.environ.pop(PARENT, ""):
    _server = os.getpid()
    end_with_parent(int(_parent))
    os.register_at_fork(after_in_child=lambda: end_with_parent(_server))
