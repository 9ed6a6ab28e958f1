"""The lumen of a label volume: smooth walls, their union, distances, paths and ends of vessels."""
