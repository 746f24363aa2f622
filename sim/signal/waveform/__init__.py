"""The waveform: PRS sequence, OFDM grid and the times at which beam pairs are measured.

Read `prs.py` first (`PrsConfig`, `prs_symbols`), then `schedule.py` (`PrsSchedule`) and `occasions.py`
(`sweep_occasions`). `ofdm.py` (`modulate`, `demodulate`) and `time_domain.py` (`received_samples`) make I/Q
samples.
"""
