"""Controller and rig together on one bus: in virtual time, live as two processes, and with the
board's firmware between rig and bus."""
