"""Calibration of the arrays from the sweeps of a campaign, without known directions.

Read `self_calibration.py` first (`self_calibrate`). `joint.py` fits the arrays with all paths of some stops that
`strong.py` finds, by the normal equations of `normal.py`; `ends.py` has the arrays as sums of their elements.
Where phases are lost, `rank_one.py` uses the single paths of `dominant.py`. `remaining.py` says what calibration
leaves.
"""
