"""The digital twin of a measured hall: its simulated paths beside the measured ones."""
