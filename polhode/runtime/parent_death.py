"""Processes that end with the one that started them, even if that is killed and whatever they are doing.

Linux sends the signal (``prctl``, PR_SET_PDEATHSIG) when the thread that started the process ends. Elsewhere
these functions change nothing.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

PR_SET_PDEATHSIG = 1
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
