"""Many runs at once: which cases, what is watched in each, what they come to. `hil.cli` runs them."""
