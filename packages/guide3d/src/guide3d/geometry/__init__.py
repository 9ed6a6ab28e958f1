"""Geometry of two views: cameras, distortion, epipolar lines, curves. It never imports torch."""
