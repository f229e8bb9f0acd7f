"""The campaign: seeded Monte Carlo over gearboxes as built, strategies compared on the same draws."""
