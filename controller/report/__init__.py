"""What the controller sends about itself: status, estimates, outcomes, lines of the log."""
