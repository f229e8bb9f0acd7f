"""What both presets use: sleeves, edge arrays, the bench script, and the valve drivers, whose
contract is docs/wire.md."""
