"""Navigation on curves that SplineFormer reads."""
