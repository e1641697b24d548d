"""The control laws of the bench. `hil.bench.laws` has their names, docs/reference/laws.md says where they come from."""
