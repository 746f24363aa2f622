"""Diffraction: vertical edges, edges of meshes, and creeping waves around smooth solids.

Read `edge_paths.py` first (`diffracted_paths`) with `wedge.py` (`wedge_gain`), then `creeping.py`
(`creeping_paths`) with `fock.py` (`convex_creeping_gain`), then `mesh_edges.py` (`diffracted_by_meshes`).
"""
