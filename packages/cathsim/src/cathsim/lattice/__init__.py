"""Regular lattices of which only the blocks near a vessel are stored."""
