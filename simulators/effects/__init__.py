"""Drops with real effects that the header of the trace file does not declare.

Finite elements compute the ground (`response`). Hammer, plate and nonlinear contact are stepped
through time on it (`march`, `soil`, `mechanics`), and operators in time act on the channels
(`channels`). `unmodelled` and `faults` have effects outside the vocabulary of the diagnosis.
`catalogue.EFFECTS` contains all of them by name; `simulators.campaign` writes trace files of them.
"""
