"""What both gearboxes have alike: valves, sleeves, the bench script, edge arrays."""
