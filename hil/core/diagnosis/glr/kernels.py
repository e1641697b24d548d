"""The compiled functions that Python calls at every step, see `compiled.entry_point`."""

from __future__ import annotations

from hil.core.diagnosis.glr import bank, growth, noise_learning, refilter
from hil.core.diagnosis.glr import filter as level_filter
from hil.core.diagnosis.glr import model as process_model
from hil.core.diagnosis.glr.compiled import entry_point

predict = entry_point(process_model.predict)
flow_voltage = entry_point(process_model.flow_voltage)
filter_step = entry_point(level_filter.filter_step)
learn_scale = entry_point(noise_learning.learn_scale)
learn_process_noise = entry_point(noise_learning.learn_process_noise)
grow = entry_point(growth.grow)
advance_bank = entry_point(bank.advance)
update_bank = entry_point(bank.update)
catch_up = entry_point(refilter.catch_up)
