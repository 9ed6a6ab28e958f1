"""Labels of a volume: which vessel each is, whether that can be, how they hang together."""
