"""Calibration of X-ray cameras and of their detectors' distortion."""
