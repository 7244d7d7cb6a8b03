"""Imported first by the server that forks the workers: it ends with the process that started it.

The server would otherwise wait for its workers, which wait for it. The workers end with the server, even
while they still import what they will work on.
"""

import os

from polhode.runtime.parent_death import end_with_parent

PARENT = "POLHODE_PARENT"
"""Environment variable: the number of the process that starts the server in its main thread."""

if parent := os.environ.pop(PARENT, ""):
    server = os.getpid()
    end_with_parent(int(parent))
    os.register_at_fork(after_in_child=lambda: end_with_parent(server))
