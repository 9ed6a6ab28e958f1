"""Public data that claims are measured on: where they are from, and how they come to this machine."""
