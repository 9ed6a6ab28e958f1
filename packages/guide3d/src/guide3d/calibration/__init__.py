"""Calibration of a rig of detectors: distortion by a perforated sheet, cameras by a bead cube, without a click."""
