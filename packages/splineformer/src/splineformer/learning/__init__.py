"""Training of SplineFormer."""
