"""Scores of every stage against the true geometry: the only place that sees both.

Read `score.py` first; `stages/` scores each stage, `metrics/` holds the metrics, `record.py` the tables.
"""
