"""Scores of every stage against the truth: the only package that reads both.

Read `score.py` first (`score_campaign`, `Scores`), then `record.py` (`ScoreTables`). `stages/` scores each stage,
`metrics/` has the metrics, `causes.py` says why a path is false or missed.
"""
