"""The data set: annotations, images, cameras and true curves, read, split, planned and annotated."""
