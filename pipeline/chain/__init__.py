"""Several stages of a run: in which order, beside each other or not, and how long they take."""
