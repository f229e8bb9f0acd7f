"""Controller and rig together on one bus: in virtual time, and live as two processes."""
