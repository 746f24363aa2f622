"""Extended object estimation: contours from incidence points and paths.

Read `gp/estimate.py` for the method of the paper and `contours.py` for ours; `record.py` holds their results.

`gp/`      clusters and radial Gaussian processes (the paper)   `reflection/`  contours by the reflection law
`kinds/`   walls, edges, closed contours                        `points/`      contours from incidence points
only `baselines/`  methods of others, for comparison                 `config.py`    settings
"""
