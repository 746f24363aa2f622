"""Mapping and SLAM: paths in, incidence points and receiver poses out.

Read `stops.py` first: `locate_and_map` chooses the method; `record.py` defines the results.

`mapping/`   incidence points for known poses      `snapshot/`  each stop alone
`walk/`      all stops together, or a filter        `space/`     the same with heights
`bounds.py`  Cramer-Rao bounds                      `config.py`  settings
"""
