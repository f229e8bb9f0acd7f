"""Parameters of a gearbox from what a log holds, each with its interval; knows nothing of a rig."""
