"""Made scenarios with known truth for the checks: halls, walks, pillars, walls, paths, links and campaigns.

Read `halls.py` first. `reflections.py` has single objects seen from a walk, `link_bench.py` stops for channel
estimation, `solids.py` scenes for ray tracing, and `perfect_campaign.py` the results of an estimator without
error.
"""
