"""Identification: a rig's parameters, with honest intervals, from records of its voltages and readings.

Pure, as all of `hil.core`: numbers in, numbers out. Module by module:

    records      what was measured: voltages, readings, and levels read by a ruler
    parameters   one row for each parameter: name, unit, meaning, and where the rig file has it
    result       what an identification returns
"""
