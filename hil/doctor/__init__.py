"""Whether a bench is fit to be run: what was observed, judged by pure checks; commands go out through a probe."""
