"""What has been learned, as values (`learned`) and as a file (docs/calibration.md)."""
