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
    robust_fit   the robust fit from afar, from which an estimate starts
    whitening    the filter that makes residuals white: waves and turbulence
    noise_model  how large the sensors' noise, waves and turbulence are
    intervals    the covariance of the estimate, where residuals are still coloured, too
    problem      the linearised problem at some values
    gauss_newton the way to its minimum
    estimate     generalised least squares with the noise model
    null_directions  what the records do not determine, in words
    structure    which extensions a held-out record asks for
    starting     what the sensors show of known levels
    identify     all of it: from records to an Identification
    result       what an identification returns
"""
