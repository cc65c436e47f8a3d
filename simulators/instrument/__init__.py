"""Simulated instrument that sends drops from finite elements over a virtual serial port or TCP.

A scenario describes the simulation: soil, falling weight, instrument, link and faults.
"""

from simulators.instrument.endpoint import EndpointError
from simulators.instrument.run import SimulatedInstrument, SimulateOptions, serve, simulate
from simulators.instrument.scenario import (
    Scenario,
    ScenarioError,
    builtin_scenarios,
    load_scenario,
)

__all__ = [
    "EndpointError",
    "Scenario",
    "ScenarioError",
    "SimulateOptions",
    "SimulatedInstrument",
    "builtin_scenarios",
    "load_scenario",
    "serve",
    "simulate",
]
