"""Estimators: they see observations, never the truth.

The steps in their order: `channel/` (samples to paths), `slam/` (paths to poses and incidence points), `shape/`
(incidence points and paths to contours). `laws/` holds the reflection law, `inference/` what the estimators share.
"""
