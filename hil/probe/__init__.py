"""What `hil doctor` and `hil conformance` share: listening to a bus, sending single commands, results."""
