"""From paths to samples: equation (1) with arrays, waveform, noise and hardware.

Read `generation.py` first: `beam_channel` computes equation (1). Then `link.py`: `make_link` builds the waveform,
the codebooks and the power of a campaign, which are the same at every stop.

`arrays/`    elements, beams and codebooks        `waveform/`        PRS, OFDM and the schedule
`hardware/`  impairments of TX and RX             `link_budget.py`   `link_budget`, power levels at every stop
`noise.py`   `add_noise`, thermal noise
"""
