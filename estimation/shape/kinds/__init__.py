"""Kinds of objects that the reflection law is fitted to.

Read `fit.py` first. `closed.py`: closed contours. `mirror_wall.py`: walls. `edge.py`: corners and door jambs.
`arc.py`: slightly curved walls.
"""
