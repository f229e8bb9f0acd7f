"""The errors of the command line itself."""


class CommandError(Exception):
    """An argument that cannot be used; one line that says what was found and what is allowed."""


class RunError(Exception):
    """What ran has failed, by no fault of its arguments; one line says what, and what to do."""
