"""Checks of several TX: `stops.py` poses of stops and walks against bounds, `samples.py` shared resources.

`drawn.py` draws what a receiver estimates of several TX.
"""
