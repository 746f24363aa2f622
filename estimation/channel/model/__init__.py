"""The model of a beam sweep that all maximum-likelihood methods use.

Read `manifold.py` first (responses of beams over direction), then `compress.py`, `path_model.py` and `crb.py`.
"""
