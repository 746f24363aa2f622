"""Import and export of campaigns in the formats of other tools.

Read `formats.py` first: what `arena export` writes. `measurement.py` (with the MATLAB layout in `mat.py`),
`deepmimo.py`, `geojson.py`, `sigmf_recording.py` and `nist_qd.py` hold a format each.
"""
