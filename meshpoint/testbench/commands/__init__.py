"""The commands of `meshpoint`, one file for each: arguments in, exit code out."""
