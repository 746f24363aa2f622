"""Extended object estimation: incidence points and paths in, contours out.

Read `gp/estimate.py` for the paper's method and `contours.py` for ours; `record.py` holds what they return.

`gp/`      clusters and radial Gaussian processes (the paper)   `reflection/`  contours by the reflection law
`kinds/`   walls, edges, closed contours                        `points/`      contours from incidence points only
`baselines/`  methods of others, for comparison                 `config.py`    settings
"""
