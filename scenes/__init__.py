"""The world: pure geometry and materials, no radio."""
