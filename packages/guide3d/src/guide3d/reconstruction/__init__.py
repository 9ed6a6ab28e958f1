"""Reconstruction of a wire in space from two images."""
