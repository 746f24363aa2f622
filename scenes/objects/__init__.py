"""What stands in a scene: vertical prisms over a contour, clutter given as meshes, and their materials.

Read `scene_object.py` first, then `material.py` and `clutter.py`; `config.py` is their form in scene files.
"""
