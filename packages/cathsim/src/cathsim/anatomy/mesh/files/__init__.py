"""Files of surfaces: VTK PolyData, STL, OBJ, and what trimesh reads, as points and triangles."""
