"""The compiled functions that Python calls at every step, see `compiled.entry_point`."""

from __future__ import annotations

from hil.core.diagnosis.glr import bank, replay
from hil.core.diagnosis.glr import filter as level_filter
from hil.core.diagnosis.glr.compiled import entry_point

filter_step = entry_point(level_filter.filter_step)
learn_scale = entry_point(level_filter.learn_scale)
advance_bank = entry_point(bank.advance)
update_bank = entry_point(bank.update)
catch_up = entry_point(replay.catch_up)
