"""Mutation testing of what keeps the rig safe: for every small change of it some test has to fail.

`make mutants`. The mutants are cosmic-ray's; a fork of one process that has everything loaded runs each, in half a
second instead of several. Nothing on disk is touched. `accepted.toml` lists what may survive, each with its reason.
"""
