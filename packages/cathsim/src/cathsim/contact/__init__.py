"""Contact between the wire and the vessel's wall."""
