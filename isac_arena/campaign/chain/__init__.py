"""The functions of the estimation chain: sweeps to channel estimates, to maps, to shapes. Records in, records out.

The driver calls them in order. Read `inputs.py` first, then `one_map.py` and `maps.py`; `links.py` and
`walks.py` are for campaigns with several links.
"""
