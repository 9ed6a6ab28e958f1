"""Kinds and checks of settings."""
