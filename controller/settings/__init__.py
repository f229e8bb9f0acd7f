"""What a run is given: settings, header, what was learned before (docs/calibration.md)."""
