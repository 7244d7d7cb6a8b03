"""The two errors that end a command, with their exit codes, and text that a terminal can show safely."""


class InputError(Exception):
    """A user's mistake: wrong usage or input. One line: what, where, what to do. Exit code 2."""

    exit_code = 2


class RunFailure(Exception):
    """The run failed on valid input; what was found is written. Exit code 1."""

    exit_code = 1


def one_line(text: str) -> str:
    """A message as one line; control characters, which a file's name or content may hold, as escapes."""
    return printable(" ".join(text.split()))


def printable(text: str) -> str:
    """Characters that a terminal would obey instead of showing them, and broken bytes, as escapes."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
