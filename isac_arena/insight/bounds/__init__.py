"""Cramer-Rao bounds over the plan of a scene and along its walk.

Read `position.py` first: bounds of the receiver (`bound_inputs`, `over_plan`, `along_walk`). `channel.py` has the
bounds of delays and angles.
"""
