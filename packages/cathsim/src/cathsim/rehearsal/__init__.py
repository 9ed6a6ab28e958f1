"""Copies of an anatomy that differ from its scan as a patient does on the day, and the environment over them."""
