"""Aortic arches of six branching types, from published waypoints of their vessels."""
