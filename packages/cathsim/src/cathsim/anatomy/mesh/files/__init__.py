"""Files of surfaces: VTK PolyData, STL, OBJ, OFF, and what trimesh reads, as points and triangles."""
