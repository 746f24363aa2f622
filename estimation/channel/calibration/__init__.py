"""Calibration of the arrays from the sweeps of a campaign, without known directions.

Read `self_calibration.py` first (`self_calibrate`); `dominant.py` finds the single paths that it uses.
"""
