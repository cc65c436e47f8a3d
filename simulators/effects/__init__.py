"""Drops with real effects that the trace's header does not declare.

Finite elements give the ground (`response`), a march through time puts hammer, plate and non-linear
contact on it (`march`, `soil`, `mechanics`), operators in time act on the channels (`channels`).
`unmodelled` holds effects that no catalogue names. `catalogue.EFFECTS` has them all by name;
`simulators.campaign` writes trace files of them.
"""
