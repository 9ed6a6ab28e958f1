"""Devices that are steered in a vessel: guidewires and catheters, their presets and pictures."""
