"""Anatomies imported from label volumes (segmentations of a CT): NIfTI, NRRD, or a folder with one file a vessel."""
