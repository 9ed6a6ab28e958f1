"""Surfaces that come in parts."""
