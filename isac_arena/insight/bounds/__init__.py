"""Cramer-Rao bounds over the plan of a scene and along its walk.

`position.py`: of the receiver. `channel.py`: of delays and angles.
"""
