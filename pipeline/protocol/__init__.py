"""The protocol of the evaluation: what is claimed, how it is measured, and results with every case."""
