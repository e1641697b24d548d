"""Campaigns of many runs: cases, observation of each run, outcomes, statistics, report. `hil.bench` runs them."""
