"""What the controller says on the bus and in the log."""
