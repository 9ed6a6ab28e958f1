"""Reconstruction of wires: two annotated images and two cameras to a curve in space, with its uncertainty."""
