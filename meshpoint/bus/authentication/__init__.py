"""Optional: commands that prove who sent them (docs/wire.md, decision 0014)."""
