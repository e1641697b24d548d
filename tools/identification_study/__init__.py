"""Drawn rigs, an experiment on each, and how well they are identified: `python -m tools.identification_study`."""
