"""The operator's panel: a terminal application that watches a run through its control channel and sends it requests."""
