"""When to release the brake and when to fire, by strategy."""
