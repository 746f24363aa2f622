"""Diffraction: vertical edges, edges of meshes, and creeping waves round smooth solids.

Read `edge_paths.py` first, with `wedge.py` for the coefficient; then `creeping.py`, with `fock.py`.
"""
