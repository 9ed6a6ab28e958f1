"""The Guide3D data set: its layout, its annotation and its split."""
