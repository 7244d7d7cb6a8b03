"""The two ways in which a command ends early, each with its exit code."""


class InputError(Exception):
    """The user's mistake: bad usage or bad input. One line: what, where, what to do. Exit code 2."""

    exit_code = 2


class RunFailure(Exception):
    """The run failed on valid input; what was found is written. Exit code 1."""

    exit_code = 1
