"""Exact specular paths: images for flat walls, stationary points for curved walls, exact points on mesh facets.

Read `solver.py` first (`ExactSolver`, `exact_paths`), then `images.py` (`planar_paths`), `curved.py`
(`curved_paths`) and `curved_pairs.py` (`curved_curved_paths`), all in plan view, `rays.py` (heights) and
`path_gain.py` (the field along a ray). `fresnel.py` holds `slab_reflection` and `slab_transmission`.
"""
