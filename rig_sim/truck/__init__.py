"""The preset `truck`: a gearbox with the imperfections of a real one (docs/gearbox.md).

`faults` injects faults of sensors, valves and other parts; `truck.toml` has the parts' tolerances.
Tooth counts and inertias are in the data sheet, `meshpoint/gearbox/sheets/`.
"""
