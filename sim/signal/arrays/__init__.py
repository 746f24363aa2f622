"""Antenna arrays and their beams.

Read `array.py` first (`upa_positions_m`, `steering_vector`), then `beams.py` (`steered_beams`, `dft_beams`) and
`codebook.py` (`Codebook`, `beam_response`). `weights_file.py` reads beam weights from a file.
"""
