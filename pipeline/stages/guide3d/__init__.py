"""The stage guide3d: the bi-planar data set and its reconstruction."""
