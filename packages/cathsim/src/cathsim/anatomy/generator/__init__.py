"""Aortic arches generated from parameters."""
