"""From frames to numbered edges (docs/edges.md), speeds, positions and gears in mesh."""
