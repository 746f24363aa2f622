"""Functions of a user in place of our stages: channel estimation, mapping, SLAM, contours and tracks.

`config.py` has their settings, `contracts.py` what each stage gets and returns, with the checks of its result. A
function runs in a process of its own: `room.py` is our side of it, `inside.py` the other.
"""
