"""Nodes on a bus: `meshpoint controller`, `rig`, `up`, `request`."""
