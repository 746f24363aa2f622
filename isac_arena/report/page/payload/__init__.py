"""The data of the report page: one dictionary of plain numbers and texts, ready for JSON.

Read `campaign.py` first: `report_payload`. `paths.py` and `maps.py` make its parts, `numbers.py` rounds,
`thinning.py` chooses the stops of a long campaign.
"""
