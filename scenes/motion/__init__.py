"""What moves in a scene: rigid motions over time.

Read `motion.py` first: a `Motion` tells shift, turn and their derivatives at any time. `config.py` reads one from
a scene file, `placed.py` moves contours, objects and meshes, `collisions.py` refuses what drives through others.
"""
