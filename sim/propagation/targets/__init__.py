"""Paths over targets of TR 38.901 clause 7.9.

`rcs.py` has their radar cross-section, `paths.py` finds the paths.
"""
