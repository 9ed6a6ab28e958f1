"""Pictures of phantoms, of imports with what is unsure about them, and of what was refused."""
