"""Controller and rig on one bench: virtual time, demo, replay, reports and the command line."""
