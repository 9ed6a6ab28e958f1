"""The networks: patch encoder, autoregressive spline decoder, tip predictor, and the parallel variant."""
