"""Incidence points of single bounces for known receiver states, equations (2) to (4).

Read `incidence_points.py` first; `point_fit.py` is the fit of one point.
"""
