"""A small open data set of simulated shifts, and a task on it: the phase at contact, ahead."""
