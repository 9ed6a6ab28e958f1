"""A patient's CT as the surroundings of the vessels."""
