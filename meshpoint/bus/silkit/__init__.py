"""Vector SIL Kit as a bus: the python-can interface `silkit`, and what a coordinated run shares."""
