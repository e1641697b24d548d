"""Identification: a rig's parameters, with honest intervals, from records of its voltages and readings.

Pure, as all of `hil.core`: numbers in, numbers out. Module by module:

    records      what was measured: voltages, readings, and levels read by a ruler
    parameters   one row for each parameter: name, unit, meaning, and where the rig file has it
    pump_kernel  the compiled simulation of the pumps with its derivatives
    kernel       that of the tanks
    simulation   levels and readings of a record from its voltages
    residuals    whitened residuals; saturated readings; the ruler's
    unknowns     what a fit looks for, with limits and priors
    minimum      the minimum at a given noise, and the noise of residuals
    starts       other starts, for a fit that ended far from its readings
    fit          the least-squares fit
    result       what an identification returns
"""
