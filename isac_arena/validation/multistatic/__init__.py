"""Checks of several TX: `stops.py` poses of stops and walks against bounds, `samples.py` shared resources.

`links.py` has uplinks and monostatic nodes. `placement.py` places TX and compares expected with achieved errors.
`campaigns.py` has the scores of a campaign of the library. `drawn.py` and `arenas.py` draw what a receiver
estimates of several TX.
"""
