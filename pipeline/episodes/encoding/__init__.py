"""The encoding of episode logs: the MCAP container and its messages."""
