"""The shift sequence: its states, a file for each phase, the valve commands (docs/shifts.md)."""
