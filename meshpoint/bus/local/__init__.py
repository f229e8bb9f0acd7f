"""The local bus: a hub, and the python-can interface `meshpoint` to it."""
