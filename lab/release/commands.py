"""Other programs: started without what this process has set for Python, their failure in one line."""

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

from polhode.runtime.errors import RunFailure


def call(folder: Path, *command: str | Path, environment: Mapping[str, str] | None = None) -> str:
    """What ``command`` prints on standard output when it runs in ``folder``.

    Without an ``environment`` it gets ours, but for the variables that change which modules Python finds.
    Raises RunFailure: the program is missing or failed; the line holds the last one of its errors.
    """
    words = [str(word) for word in command]
    given = own_environment() if environment is None else dict(environment)
    try:
        done = subprocess.run(words, cwd=folder, env=given, capture_output=True, text=True, check=False)
    except OSError as error:
        raise RunFailure(f"{words[0]} cannot be started: {error.strerror}") from error
    if done.returncode != 0:
        last = (done.stderr.strip() or done.stdout.strip() or "nothing was printed").splitlines()[-1]
        raise RunFailure(f"'{' '.join(words)}' ended with exit code {done.returncode}: {last}")
    return done.stdout


def own_environment() -> dict[str, str]:
    """Our environment variables without Python's own."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
