"""Hardware that is not ideal: arrays, oscillators, clocks and the front end of the receiver.

Read `config.py` first (every impairment with its unit), then `impairments.py` (one function each) and
`apply_impairments.py` (where each one is applied).
"""
