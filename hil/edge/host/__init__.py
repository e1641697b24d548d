"""The computer: clock, signals, real-time scheduling, facts for `hil doctor`."""
