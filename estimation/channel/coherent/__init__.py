"""Coherent maximum likelihood: the phases are known from beam pair to beam pair.

Read `paths.py` first (`fit_coherent`), then in the order of the method `plan.py` (levels, delay window),
`search.py` (matched filter), `refine.py` (joint fit), `prune.py` (model order, hidden second paths), `cancel.py`,
`elevated.py`; `diffuse.py` (`fit_over_background`) adds diffuse background, `misfit.py` errors of the model.
"""
