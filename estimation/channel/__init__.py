"""Channel parameter estimation: beam sweeps in, delays, angles and powers of paths out.

Read `estimate.py` first: `estimate_channel` is the one entry; `record.py` holds what it returns.

`power/`        from beam powers alone                   `coherent/`    maximum likelihood with phases
`incoherent/`   maximum likelihood without phases        `auto.py`      chooses between the two
`model/`        beam responses, compression, bounds      `calibration/` array responses from the campaign itself
"""
