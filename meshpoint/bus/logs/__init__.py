"""CAN logs: read with limits, written in parts."""
