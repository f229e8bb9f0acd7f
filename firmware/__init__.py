"""C sources of the board that reads the gearbox's sensors and drives its valves (docs/firmware.md).

Nothing here is Python: `meshpoint.bench` builds and runs them."""
