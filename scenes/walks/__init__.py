"""The walk of the receiver: its stops and the pose at each.

Read `trajectory.py` first; `config.py` is the form of a walk in scene files, `tum.py` reads recorded ones.
"""
