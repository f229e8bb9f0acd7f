"""Recorded logs and captures through the controller."""
