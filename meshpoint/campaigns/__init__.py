"""The campaign: seeded Monte Carlo over gearboxes as built, all strategies on the same draws."""
