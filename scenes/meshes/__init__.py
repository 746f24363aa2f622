"""Triangle meshes of scenes, and floor plans of line segments. Only this package imports trimesh.

Read `mesh.py` first: `object_meshes` converts a scene to meshes, `read_mesh` reads a mesh file, `glb_bytes`,
`ply_bytes` and `write_mitsuba` export. `merge_segments` in `floorplan.py` merges drawn segments into walls.
"""
