"""Calls on worker processes, by dask: of the cases of a sweep, and of the stops of a campaign.

Read `workers.py` first, then `tasks.py` (calls and how they end), `cluster.py` (the processes) and `stops.py` (the
stops of a campaign).
"""
