"""Anatomies that are published with their centrelines."""
