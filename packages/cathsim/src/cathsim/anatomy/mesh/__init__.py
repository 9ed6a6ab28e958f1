"""Anatomies imported from a surface mesh."""
