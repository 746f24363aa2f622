"""The shapes of the paper: clusters of incidence points, and a radial Gaussian process for each.

Read `estimate.py` first, then `clustering.py` and `radial.py`; `exact.py`, `fourier.py` and `newton.py` hold the
computations.
"""
