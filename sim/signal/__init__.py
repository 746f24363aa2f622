"""From paths to samples: equation (1) with arrays, waveform, noise and hardware.

Read `generation.py` first: equation (1). Then `link.py`: what stays the same over a campaign.

`arrays/`    elements, beams and codebooks        `waveform/`  PRS, OFDM and their schedule
`hardware/`  impairments of both ends             `link_budget.py`  levels at every stop
"""
