"""Checks of propagation against closed forms, exact fields, shot rays and the ray tracer.

Read `closed_form.py` first.
"""
