"""The board's firmware in the loop: its C sources built for this machine, between rig and bus."""
