"""Numerical methods that estimators share.

`least_squares.py`: the damped Gauss-Newton loop `minimise`, and the efficiency of Student-t estimates. `arrow.py`:
systems of one block per stop and shared parameters.
"""
