"""Faces of objects from mirrored and scattered paths.

Read `find.py` first; `scattering.py` has the evidence, `points.py` the lines through incidence points, `bends.py`
the curved ones, `parts.py` the gaps, `face.py` the result.
"""
