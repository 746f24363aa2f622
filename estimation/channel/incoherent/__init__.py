"""Maximum likelihood when every beam pair has an unknown phase.

Read `paths.py` first; then in order `spectrum.py`, `screen.py`, `search.py`, `likelihood.py`.
"""
