"""Numerical methods that estimators share.

`least_squares.py`: the damped Gauss-Newton loop. `arrow.py`: systems of one block per stop and shared parameters.
`student.py`: information under Student-t errors.
"""
