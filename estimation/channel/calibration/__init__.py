"""Array responses learned from the campaign itself.

Read `self_calibration.py` first; `dominant.py` finds the paths that it uses.
"""
