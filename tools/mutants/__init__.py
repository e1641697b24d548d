"""Mutation tests: a test has to fail for every small change of the safety modules, and for a sample of those elsewhere.

`make mutants`, or `make mutants SAMPLE=100 SEED=7`. The mutants are cosmic-ray's; a fork of one process that has
imported the libraries judges each, in half a second instead of several. No file is changed. Two processes at a time run
about 20 sampled mutants in two minutes. `accepted.toml` lists the mutants that may survive, each with its reason.
"""
