"""One module for each command: its options, an example for its help, and the call of what does the work.

A module here is imported to show the help, so it imports what does the work inside its function. A new command is a
module here and a row in the table of `hil.cli.app`.
"""
