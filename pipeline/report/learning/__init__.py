"""The report's section on learning, computed from evaluation logs."""
