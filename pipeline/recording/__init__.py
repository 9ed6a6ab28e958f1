"""Recording and replay of episodes."""
