"""Channel parameter estimation: beam sweeps in, delays, angles and powers out."""
