"""Numerical methods that estimators share.

`arrow.py`: least squares with one block per stop and shared parameters. `student.py`: information under
Student-t errors.
"""
