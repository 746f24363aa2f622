"""The reflection law: delay and angles of a path, given TX, RX and the reflecting object, with derivatives.

Read `plane.py` first: incidence points in the plane. `space.py` adds heights, `contour.py` reflects off a
convex contour.
"""
