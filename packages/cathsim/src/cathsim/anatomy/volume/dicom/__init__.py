"""Volumes in DICOM files: series of slices, segmentations, contours of structure sets."""
