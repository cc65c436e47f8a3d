"""The drops of a test point as models that share the ground's response."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np

from inversion.diagnosis.ground_response import GroundResponse
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.rest import drops_at_rest
from inversion.fitting.layered.first_look import FirstLook
from inversion.fitting.layered.misfit import LayeredDrop
from inversion.forward.library import SurrogateLibrary
from inversion.forward.surrogate import Surrogate
from inversion.measured.half_sine import fit_half_sine
from inversion.measured.peak_method import peak_modulus
from inversion.measured.record import Record, prepare


class Point:
    """A test point: the models of its drops.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary
    """

    def __init__(self, records: PointRecords, library: SurrogateLibrary) -> None:
        self.records = records
        first = records.records[0]
        self.declared_depth = first.bedrock_depth
        surrogate = surrogate_of(first, library)
        largest = max(float(np.max(r.load)) - float(r.load[0]) for r in records.records)
        layers = _first_look(records)
        longest = max(float(item.drop.with_tail().tail_end) for item in layers.drops)
        response = response_of(first, surrogate, library)
        self.drops = tuple(
            DropModel(record, surrogate, largest, index, records, layers, response, longest, rest)
            for index, (record, rest) in enumerate(
                zip(records.records, drops_at_rest(records.records), strict=True)
            )
        )
        peaks = [
            peak_modulus(
                model.drop.peak_load,
                max(model.peak_in_contact, 1e-9),
                first.instrument.plate_radius,
                first.poisson_ratio,
            ).modulus
            for model in self.drops
        ]
        self.peak_modulus = float(np.median(peaks))
        layers.peak_modulus = self.peak_modulus

    def coarse(self) -> Point:
        """The point with fewer samples, for fits that choose effects.

        Beside the plate layers are solved for, which costs the more the more frequencies there are:
        there the band ends where the loads have hardly any spectrum left. What that changes, up to
        2e-3 of the peak, is more than noise may be.
        """
        if self.drops[0].context.offsets.size == 1:
            return self
        band = max(model.least_band for model in self.drops)
        other = copy.copy(self)
        other.drops = tuple(model.in_band(band) for model in self.drops)
        return other


def surrogate_of(record: Record, library: SurrogateLibrary) -> Surrogate:
    """Return the surrogate for the plate, the sensors and the declared depth of a record."""
    from inversion.drop_inversion import Settings, surrogate_request

    # A declared half-space may be wrong: rock is offered there too.
    open_below = record.bedrock_depth is None or np.isinf(record.bedrock_depth)
    depth: Any = "unknown" if open_below else record.bedrock_depth
    problem, ratio = surrogate_request(record, Settings(bedrock_depth=depth))
    return library.get(problem, ratio)


def response_of(record: Record, surrogate: Surrogate, library: SurrogateLibrary) -> GroundResponse:
    """Return the response of the ground at the sensors of a record, without their geophones."""
    instrument = replace(record.instrument, geophone_natural_frequency=None, geophone_damping=None)
    offsets = [abs(sensor.offset) for sensor in record.nearest_first().sensors]
    return GroundResponse(surrogate, instrument, offsets, library)


def _first_look(records: PointRecords) -> FirstLook:
    """The drops of a point as layered ground."""
    first = records.records[0]
    drops = []
    for record in records.records:
        # As the drops' models have their sensors.
        drop = prepare(record.nearest_first())
        load = drop.load
        if records.half_sine:
            load = fit_half_sine(drop.time, drop.load).load(drop.time)
        drops.append(LayeredDrop.of(drop, record.instrument, load, record.model_floor))
    return FirstLook(
        drops,
        first.poisson_ratio,
        first.density,
        first.bedrock_depth,
        records.elastic,
        math.nan,
    )
