"""Why results are as they are.

`budget/`: which stage causes which error. `comparison/`: two runs side by side. `twin/`: a measured hall beside
its simulation. `bounds/`: what is possible at all. `ablation.py`: one impairment at a time.
"""
