"""From configuration files to objects to a run: in lockstep, live, or one case of a campaign. No terminal."""
