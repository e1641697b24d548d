"""Controller process of the four-tank bench: control law, diagnosis, safety, CAN and records."""

__version__ = "0.1.0"
