"""The other nodes of the truck that the gearbox is in: what they say of wheels, shaft and vehicle.

`nodes` sends each message at the cycle time of `dbc/truck.dbc`, from `brakes` and `output_shaft`,
which measure by the teeth of a `tone_ring`. docs/wire.md has every error with its value.
"""
