"""Planning: shortest paths in the lumen and expert control by sampling."""
