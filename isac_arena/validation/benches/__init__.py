"""Times and memory, as ratios to work done in the same run."""
