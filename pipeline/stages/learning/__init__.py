"""Jobs of the learning stages."""
