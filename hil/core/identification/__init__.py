"""Identification: a rig's parameters, with honest intervals, from records of its voltages and readings.

Pure, as all of `hil.core`: numbers in, numbers out. Module by module:

    records      what was measured: voltages, readings, and levels read by a ruler
    parameters   one row for each parameter: name, unit, meaning, and where the rig file has it
    kernel       the compiled simulation with its derivatives
    simulation   levels and readings of a record from its voltages
    residuals    whitened residuals; saturated readings; the ruler's
    unknowns     what a fit looks for, with limits and priors
    fit          the least-squares fit
    result       what an identification returns
"""
