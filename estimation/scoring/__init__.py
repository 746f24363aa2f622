"""Scores of every stage against the true geometry: the only estimation package that sees the truth."""
