"""Scores of every stage against the truth: the only package that reads both.

Read `chain.py` first (`score_campaign`), then `score.py` (`Scores`) and `record.py` (`ScoreTables`). `stages/`
scores each stage, `metrics/` has the metrics, `causes.py` says why a path is false or missed.
"""
