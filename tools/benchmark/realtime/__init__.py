"""How well the real-time loop keeps time, beside `cyclictest`, and how soon it answers.

What is compared takes turns of some seconds, at the same priority, on the same processor, with the same load and
period, so that a busy machine disturbs both alike. Every loop runs in a process of its own.
"""
