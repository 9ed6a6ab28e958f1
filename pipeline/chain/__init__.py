"""Several stages of a run: in which order, and beside each other or not."""
