"""Objects of a scene: vertical prisms over a contour, clutter given as meshes, and their materials.

Read `scene_object.py` first (`SceneObject`), then `material.py` (`Material`, `itu_material`) and `clutter.py`
(`Clutter`, `mesh_crossings`). `config.py` defines their tables in scene files.
"""
