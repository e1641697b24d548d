"""Looking back at a run: tables, key figures, report, and the layout for the Rerun viewer. Reads run folders only."""
