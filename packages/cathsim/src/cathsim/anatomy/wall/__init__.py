"""The wall of a lumen: its relief, and how thick it is between two vessels."""
