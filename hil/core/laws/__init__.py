"""Control laws to compare with the state feedback: docs/reference/laws.md says where each comes from."""
