"""The walk of the receiver: its stops and the pose at each.

Read `trajectory.py` first (`Walk`, `RecordedWalk`), then `random_walk.py` (`random_walk`) and `tum.py`
(`parse_tum` reads recorded walks). `config.py` defines the tables of walks in scene files.
"""
