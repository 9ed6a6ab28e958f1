"""Imitation learning: policies that learn from an expert's actions."""
