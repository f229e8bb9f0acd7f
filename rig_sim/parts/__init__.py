"""One physical law a file."""
