"""Hardware impairments: arrays, oscillators, clocks and the front end of the receiver.

Read `config.py` first (`ImpairmentsConfig`, every impairment with its unit), then `impairments.py` (one function
each) and `apply_impairments.py` (`impaired_codebooks`, `receive_samples`: where each one is applied).
"""
