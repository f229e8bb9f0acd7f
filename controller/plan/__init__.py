"""When to release the brake and when to fire: predictions, and the `strategies` that use them."""
