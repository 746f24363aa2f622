"""Public tasks: observations for everybody, truth under a seal, and a leaderboard.

Read `making.py` first (what is given and what is sealed), then `submissions.py` (what comes back), `grading.py`
(scores and intervals), `baselines.py` (the methods of the project) and `board.py` (the leaderboard as a page).
"""
