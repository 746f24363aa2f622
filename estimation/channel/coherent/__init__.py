"""Coherent maximum likelihood: the phases are known from beam pair to beam pair.

Read `paths.py` first (`fit_coherent`), then in the order of the method `plan.py` (levels, delay window),
`search.py` (matched filter), `refine.py` (joint fit), `prune.py` (model order), `hidden.py` (second paths near
known ones), `cancel.py`, `elevated.py`. `diffuse.py` (`fit_over_background`) adds the diffuse background and the
errors of the model: `misfit.py` (weak fields), `neighbours.py` (undetected paths). `moving.py`: Doppler shifts.
"""
