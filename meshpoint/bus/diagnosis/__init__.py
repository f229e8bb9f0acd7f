"""What a garage's tool asks a node: who are you, what is wrong, what do you measure."""
