"""The one error of the command line itself."""


class CommandError(Exception):
    """An argument that cannot be used; one line that says what was found and what is allowed."""
