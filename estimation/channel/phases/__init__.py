"""Phases of beam pairs: from fitted paths, as a ramp over the beams, or tracked where they wander."""
