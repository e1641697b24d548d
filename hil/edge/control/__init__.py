"""The control channel of a run: requests of an operator, and what they see of the run."""
