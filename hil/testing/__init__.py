"""Scenarios as tests of pytest: the plugin, and the fixtures that it gives."""
