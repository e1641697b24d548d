"""The control laws. `hil.bench.law_choices` has their names, docs/reference/laws.md says where they come from."""
