"""Anatomies of a run: named and random ones, files of one's own, and the settings that choose them."""
