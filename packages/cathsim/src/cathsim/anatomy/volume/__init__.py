"""Anatomies imported from label volumes (segmentations of a CT): one file, or a folder with one file a vessel."""
