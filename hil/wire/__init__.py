"""Frames to typed records and back, by the DBC. No bus, clock or file: text, bytes and times are arguments."""
