"""The goal-conditioned environment: a new target in each episode, and rewards that can be computed for any other."""
