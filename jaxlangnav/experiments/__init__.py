"""Experiments of section 4: Monte Carlo runs, metrics and the tables they fill (host side)."""
