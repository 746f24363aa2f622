"""Metrics that do not depend on a stage.

Read `metric.py` first: `Metric` is one score with its unit and direction. `statistics.py` has the summaries.
"""
