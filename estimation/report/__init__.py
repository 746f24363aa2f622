"""Figures and the HTML report: the only home of plotting."""
