"""`meshpoint campaign` and `meshpoint study`: arguments in, exit code out."""
