"""A training from settings to the best policy, resumable at any moment."""
