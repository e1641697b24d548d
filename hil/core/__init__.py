"""The pure core: numbers and time are handed in, numbers come out. No CAN, clock, file, thread or random."""
