"""Runs beside each other: what differs in their configuration, their key figures, figures and a recording."""
