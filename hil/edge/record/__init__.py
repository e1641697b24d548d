"""The record of a run: recorder, its process, the run folder and its files, Rerun."""
