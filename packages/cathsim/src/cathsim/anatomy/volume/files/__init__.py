"""Files of label volumes: NIfTI, NRRD, folders of them, and the labels and voxels that they hold."""
