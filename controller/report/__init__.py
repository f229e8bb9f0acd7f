"""The controller's reports: status frames and log lines."""
