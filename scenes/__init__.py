"""The world: pure geometry and materials, no radio.

Read `scene.py` first: a `Scene` holds objects, TX positions and the walk of the receiver. `load_scene` in
`config.py` reads one from TOML.

`contours/`  2-D outlines of the objects                  `objects/`  prisms, meshes as clutter, materials
`walks/`     stops of the receiver                        `meshes/`   triangle meshes and floor plans
`motion/`    what moves, and what it must not drive through
`pose.py`    frames and angles                            `record.py` arrays with named axes and units
`library/`   scenes that come with the project            `random_arena.py`  random scenes
"""
