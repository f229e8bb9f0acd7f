"""The board that reads the gearbox's sensors and drives its valves (docs/firmware.md): C sources,
and the Python that builds and runs them without one.

    build          the C sources to a library of this machine, or to a board's image
    board          what a board is to the bench
    native_board   one whose code is built for this machine (native/)
    cortex_m4      one whose image runs on an emulated chip (g474/)
    elf            an image's content

`meshpoint.bench` puts a board between rig and bus."""
