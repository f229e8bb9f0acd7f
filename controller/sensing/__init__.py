"""From frames to edges and views: sensor clock, edge gate, speeds, positions."""
