"""`meshpoint help`, and what is made of all commands: shell completion, the reference pages."""
