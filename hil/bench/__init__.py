"""Build the objects of a run from configuration files, and run it: in lockstep, live, or as a campaign. No terminal."""
