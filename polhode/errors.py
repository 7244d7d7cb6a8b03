"""The two errors that end a command, with their exit codes."""


class InputError(Exception):
    """A user's mistake: wrong usage or input. One line: what, where, what to do. Exit code 2."""

    exit_code = 2


class RunFailure(Exception):
    """The run failed on valid input; what was found is written. Exit code 1."""

    exit_code = 1
