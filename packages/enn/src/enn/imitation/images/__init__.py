"""Policies that see images: what they make of them, in one view and in two."""
