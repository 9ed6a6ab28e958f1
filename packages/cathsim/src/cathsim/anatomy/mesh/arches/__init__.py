"""Which vessel of an arch is which."""
