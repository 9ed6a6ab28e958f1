"""Evaluations: what the logged episodes of a run say, and the tables computed from them."""
