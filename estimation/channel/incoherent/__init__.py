"""Maximum likelihood when every beam pair has an unknown phase.

Read `paths.py` first (`fit_incoherent`), then in the order of the method `spectrum.py`, `screen.py` (candidates),
`proposal.py` (starting points), `search.py`, `likelihood.py` (joint fit), `clock_drift.py`, `threshold.py`,
`background.py`, `response_errors.py`, `second_path.py`, `ambiguity.py`; `kernels.py` and `grid_kernels.py` hold
the compiled loops.
"""
