"""Channel estimation: from a beam sweep to the delays, angles and powers of its paths.

`estimate_channel` in `estimate.py` is the one entry point. `record.py` holds its result, `ChannelEstimate`.

`power/`        from beam powers alone                   `coherent/`    maximum likelihood with phases
`incoherent/`   maximum likelihood without phases        `auto.py`      chooses between the two
`model/`        beam responses, compression, bounds      `calibration/` array responses from the campaign itself
`assemble.py`   from a fit to a `ChannelEstimate`        `los.py`       probability of the line of sight
"""
