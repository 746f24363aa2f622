"""Metrics, free of what they measure.

Read `metric.py` first: one score with its unit and direction.
"""
