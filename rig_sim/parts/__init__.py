"""One physical law in each file: drag, brake disc, pneumatics, engine, vehicle and others."""
