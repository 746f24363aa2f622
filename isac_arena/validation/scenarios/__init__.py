"""Synthetic scenarios with known truth: halls, walks, pillars, walls, paths, links and campaigns.

Read `halls.py` first. `reflections.py` has single objects seen from a walk, `link_bench.py` stops for channel
estimation, `solids.py` scenes for ray tracing, `perfect_campaign.py` the results of an estimator without error.
"""
