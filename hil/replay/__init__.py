"""A recorded run through today's controller, open loop: the same commands as recorded, or the first difference.

See docs/how-to/replay.md and docs/decisions/0049-replay.md.
"""
