"""Prediction of contact forces from what is observed."""
