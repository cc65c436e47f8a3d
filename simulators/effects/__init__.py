"""Simulated drops with an effect that the header of their trace file does not declare.

An effect is a deviation of ground, plate or instrument from the declared model, such as a delayed
sensor or rock below the soil. A trace file has a header of declared values and a table of samples.

Finite elements compute the ground (`response`). The motion of hammer, plate and nonlinear contact
is computed on it (`march`, `soil`, `mechanics`), and operators change the channels (`channels`).
The diagnosis knows some effects, its vocabulary; `unmodelled` and `faults` have others.
`catalogue.EFFECTS` contains all of them by name; `simulators.campaign` writes trace files of them.
"""
