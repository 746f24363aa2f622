"""Checks of channel estimation.

Read `efficiency.py` first, then `noise.py`, `hardware.py` and `arena.py`. `../scenarios/link_bench.py` makes the
stops, `matching.py` scores them.
"""
