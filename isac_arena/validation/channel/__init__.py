"""Checks of channel estimation.

Read `efficiency.py` first, then `noise.py`, `hardware.py` and `arena.py`; `scenes.py` makes the stops.
"""
