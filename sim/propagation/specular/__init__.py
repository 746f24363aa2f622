"""Exact specular paths: images for flat walls, stationary points for curved ones, exact points on mesh facets.

Read `solver.py` first, then `images.py`, `curved.py` and `curved_pairs.py` (plan view), `rays.py` (heights) and
`path_gain.py` (the field along a ray).
"""
