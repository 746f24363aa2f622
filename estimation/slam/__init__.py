"""Mapping and SLAM: paths in, incidence points and receiver poses out.

Read `stops.py` first: `locate_and_map` chooses among the methods; `record.py` holds what they return.

`mapping/`   incidence points for known poses      `snapshot/`  one stop on its own
`walk/`      all stops together, or a filter        `space/`     the same with heights
`bounds.py`  Cramer-Rao bounds                      `config.py`  settings
"""
