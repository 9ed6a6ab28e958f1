"""Weights of the shipped policies, each with a card that says what it is; `enn.shipped` reads them."""
