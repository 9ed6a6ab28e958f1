"""Files of surfaces: VTK PolyData, STL, and what trimesh reads, as points and triangles."""
