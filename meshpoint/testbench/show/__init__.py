"""`meshpoint show`: a data sheet, settings, a calibration, the messages on the bus."""
