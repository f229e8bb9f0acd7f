"""The description of the controller for calibration tools: ASAM MCD-2 MC (A2L)."""
