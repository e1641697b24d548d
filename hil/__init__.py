"""Controller process of the four-tank bench: control law, diagnosis, safety, CAN and records."""

from hil.version import __version__ as __version__
