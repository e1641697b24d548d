"""Run folders as a table.

`index_file.index_of(folder)` gives the runs below a folder, each an `indexed_run.IndexedRun`; `selection` chooses among
them by an `expression`; `trash` moves a run away.
"""
