"""The controller as an XCP slave: measured values, and settings that change between shifts
(docs/calibration.md). Commands are frames that a step consumes, so a log repeats what they did."""
