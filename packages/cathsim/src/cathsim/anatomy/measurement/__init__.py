"""How far branches' ostia are set back, as it decides which devices get in."""
