"""The controller at work: on a bus, alone there, with what it keeps from run to run."""
