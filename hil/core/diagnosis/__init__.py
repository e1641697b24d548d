"""Fault detection and isolation: the detector protocol, an ideal detector, and likelihood ratios (`glr`)."""
