"""Helpers for those who work on the project; thin command lines."""
