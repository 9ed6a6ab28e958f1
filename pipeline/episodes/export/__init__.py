"""Episode logs as data sets of other formats: LeRobotDataset v3, Minari, HDF5."""
