"""`meshpoint replay`: a recorded log through the same controller, or through another."""
