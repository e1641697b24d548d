"""A recorded run in the files of other tools: Parquet, CSV, MF4, MCAP, MATLAB, candump."""
