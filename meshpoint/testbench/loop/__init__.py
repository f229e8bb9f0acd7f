"""Controller and rig in one loop: virtual time, live, simulated."""
