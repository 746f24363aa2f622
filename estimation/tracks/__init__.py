"""Tracks of what moves: the echoes of movers from stop to stop.

Read `estimate.py` first; `record.py` holds the result. Models, association and smoothing are those of Stone Soup.

`echoes.py`   paths that move, as measurements     `law.py`      what an echo measures of a mover
`models.py`   the models of Stone Soup             `tracker.py`  echoes to tracks
`bounds.py`   what echoes tell of velocities       `nearest.py`  the baseline
"""
