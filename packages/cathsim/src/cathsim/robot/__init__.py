"""The follower robot that feeds and turns the wire."""
