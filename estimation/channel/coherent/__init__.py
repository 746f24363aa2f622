"""Coherent maximum likelihood: phases are known from beam pair to beam pair.

Read `paths.py` first; then in order `plan.py`, `search.py`, `refine.py`, `prune.py`, and `diffuse.py` for rooms.
"""
