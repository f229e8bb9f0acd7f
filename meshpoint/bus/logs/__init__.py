"""CAN log files: read with limits, written in parts. Replaying one: `meshpoint.replays`."""
