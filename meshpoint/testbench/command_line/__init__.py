"""What commands share: their arguments, help and errors, Ctrl-C, progress."""
