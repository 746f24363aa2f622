"""ISAC Arena: from a scene to scored object shapes.

Read `campaign/chain.py` first: the chain from sweeps to scores.

`campaign/`  settings, the chain and its files    `cli/`        the `arena` command
`scoring/`   estimates against the truth          `report/`     figures and pages
`insight/`   error budget, comparison, twin       `sweep/`      many campaigns
`exchange/`  formats of other tools               `validation/` checks and benches, each with its bar
"""
