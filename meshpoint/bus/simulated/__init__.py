"""A CAN bus simulated to the bit, in virtual time: lengths, arbitration, errors, bus-off, load."""
