"""Training and evaluation of the reader network on random fluoroscopy."""
