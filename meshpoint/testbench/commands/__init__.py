"""The commands of `meshpoint`, a file each: arguments in, exit code out."""
