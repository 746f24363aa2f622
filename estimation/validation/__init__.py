"""Validation: closed-form and Monte Carlo checks of every stage, each against a bar with its reason."""
