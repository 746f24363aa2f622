"""Two runs beside each other: paired differences of their scores, and settings that differ."""
