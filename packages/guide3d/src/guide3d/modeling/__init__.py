"""Networks of the Guide3D chapter in plain torch; `guide3d.build` holds their sizes."""
