"""The demo: a shipped policy steers through an anatomy that it has never seen, with a film, a log and a page."""
