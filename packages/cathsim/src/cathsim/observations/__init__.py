"""Observations of the environments."""
