"""The waveform: PRS sequence, OFDM grid and the times at which beam pairs are measured.

Read `prs.py` first, then `schedule.py` and `occasions.py`; `ofdm.py` and `time_domain.py` make I/Q samples.
"""
