"""Views of the scene on a screen."""
