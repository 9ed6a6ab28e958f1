"""Plots that stages leave in their folders."""
