"""`meshpoint fmu`: the virtual gearbox as an FMI 3.0 co-simulation unit."""
