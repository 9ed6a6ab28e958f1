"""DICOM: X-ray runs of angiography systems to images and cameras (`endonav-guide3d[dicom]`)."""
