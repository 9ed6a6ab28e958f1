"""Measures of a phantom's shape, as an anatomist takes them from a scan."""
