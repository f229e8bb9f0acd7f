"""To other tools: A2L for calibrators, FMU and SIL Kit for simulators, time series for viewers."""
