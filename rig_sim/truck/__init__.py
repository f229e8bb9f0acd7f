"""The preset `truck`: a gearbox that misbehaves like one (docs/gearbox.md)."""
