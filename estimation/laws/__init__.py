"""The reflection law: delay and angles of a path, given TX, RX and the reflecting object, with derivatives.

Read `plane.py` first: incidence points and lines of sight in the plane. `wall.py` adds flat walls, `contour.py`
closed convex contours, `space.py` heights.
"""
