"""Configuration files: TOML to validated settings, with errors that name file, key and range."""
