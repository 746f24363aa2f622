"""Flat faces of objects from mirrored and scattered paths.

Read `find.py` first; `scattering.py` has the evidence, `points.py` the lines through incidence points.
"""
