"""The whole controller without clock and bus: its step, and what it reports of itself."""
