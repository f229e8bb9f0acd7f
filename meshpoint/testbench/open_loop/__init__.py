"""What another controller would have decided in the shifts of a log, and where its tooth would have
landed."""
