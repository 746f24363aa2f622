"""Kinds of objects that the reflection law is fitted to.

`closed.py`: closed contours. `mirror_wall.py`: walls. `edge.py`: corners and door jambs. `arc.py`: gently bent
walls.
"""
