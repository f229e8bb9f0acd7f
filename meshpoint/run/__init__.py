"""Commands that run controller and rig: simulate, demo, play; nodes on a bus, and a request."""
