"""Comparison with curves traced from a segmentation."""
