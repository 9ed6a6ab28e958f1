"""The lumen of a label volume: smooth walls, their union, distances, courses and ends of vessels."""
