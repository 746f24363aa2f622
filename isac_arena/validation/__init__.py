"""Checks and benches of every stage: each row has a value, a unit and a bar with its reason.

Read `measurement.py` first: one row. Each folder holds the checks of one stage and the made scenarios that they
need.
"""
