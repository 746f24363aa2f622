"""Triangle meshes of scenes and floor plans of line segments. The only home of trimesh.

Read `mesh.py` first: `object_meshes` turns a scene into meshes. `floorplan.py` merges drawn segments into walls.
"""
