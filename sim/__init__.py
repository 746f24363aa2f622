"""The wave and the receiver: paths, arrays, PRS signal, noise and clock."""
