"""Training and prediction of the networks."""
