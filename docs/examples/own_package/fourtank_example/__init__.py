"""A design and a fault detector for the four-tank bench."""
