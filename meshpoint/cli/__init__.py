"""The command line: the table of commands, what commands share, `meshpoint help` and `show`."""
