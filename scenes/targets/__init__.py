"""Targets of TR 38.901 clause 7.9: people, AGVs, vehicles and UAVs as bodies with points that scatter.

`standard.py` reads the tables of the standard, `target.py` places the points on a body, `config.py` reads scenes.
"""
