"""Models of the drops of a test point, which share the response of the ground."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from inversion.diagnosis.ground_response import GroundResponse
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.rest import estimate_pre_trigger_noise
from inversion.forward.contact import PLATE_MODELS, PlateModel, PlateProblem
from inversion.forward.layered import LayeredPlateModel
from inversion.forward.library import SurrogateLibrary
from inversion.forward.surrogate import Surrogate
from inversion.measured.half_sine import model_load
from inversion.measured.peak_method import peak_modulus
from inversion.measured.record import Record, prepare
from inversion.measured.weighted_drop import WeightedDrop


class Point:
    """Test point with the models of its drops, which share the response of the ground.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary
    plate : contact of plate and ground
    layered : bool, True: ground without layers is also solved as a layer, without tables
    """

    def __init__(
        self,
        records: PointRecords,
        library: SurrogateLibrary,
        plate: LayeredPlateModel = "rigid-rough",
        *,
        layered: bool = False,
    ) -> None:
        self.records = records
        first = records.records[0]
        self.declared_depth = first.bedrock_depth
        self.modulus_error = max(record.modulus_error for record in records.records)
        self.contact = plate
        self.plate: Surrogate | LayeredPlateModel = plate
        if not layered and plate in PLATE_MODELS:
            self.plate = surrogate_of(first, library, plate)
        largest = max(float(np.max(r.load)) - float(r.load[0]) for r in records.records)
        # Input of a first fit of the ground; the sensors have the order of those of the drops.
        prepared = [(record, prepare(record.nearest_first())) for record in records.records]
        self.weighted = tuple(
            WeightedDrop.of(
                drop,
                record.instrument,
                model_load(drop.time, drop.load, records.load),
                record.model_floor,
            )
            for record, drop in prepared
        )
        longest = max(float(item.drop.with_tail().tail_end) for item in self.weighted)
        response = response_of(first, self.plate, library)
        self.drops = tuple(
            DropModel(record, largest, index, records, response, longest, rest)
            for index, (record, rest) in enumerate(
                zip(records.records, estimate_pre_trigger_noise(records.records), strict=True)
            )
        )
        peaks = [
            peak_modulus(
                model.drop.peak_load,
                max(model.peak_in_contact, 1e-9),
                first.instrument.plate_radius,
                first.poisson_ratio,
            )
            for model in self.drops
        ]
        self.peak_modulus = float(np.median(peaks))

    def with_modulus_error(self, error: float | None) -> Point:
        """Return the point with another error of the instrument; None: that of its records."""
        point = copy.copy(self)
        if error is not None:
            point.modulus_error = error
        return point

    def coarse(self) -> Point:
        """Return the point with a narrower frequency band, for the fits that select effects.

        With sensors outside the plate layered ground is solved, whose cost grows with the number of
        frequencies. There the band ends where the spectrum of the loads is negligible. The error,
        up to 2e-3 of the peak, is too large for the final fit.
        """
        if self.drops[0].context.offsets.size == 1:
            return self
        band = max(model.min_band_hz for model in self.drops)
        point = copy.copy(self)
        point.drops = tuple(model.in_band(band) for model in self.drops)
        return point


def surrogate_of(
    record: Record, library: SurrogateLibrary, plate: PlateModel = "rigid-rough"
) -> Surrogate:
    """Return the response table for plate, sensors and declared bedrock depth of a record."""
    return library.get(*surrogate_request(record, plate))


def surrogate_request(record: Record, plate: PlateModel) -> tuple[PlateProblem, float | None]:
    """Return plate problem and bedrock depth (plate radii) of the required response table.

    The depth is None for a table of all depths, a half-space included. It is used for a declared
    half-space too, which may be wrong.
    """
    radius, depth = record.instrument.plate_radius, record.bedrock_depth
    ratios = [round(abs(s.offset) / radius, 10) for s in record.nearest_first().sensors]
    # Offset 0 comes first: the inertia of the plate requires the motion of the plate itself.
    offsets = tuple(ratios) if ratios[0] == 0.0 else (0.0, *ratios)
    problem = PlateProblem(plate, record.poisson_ratio, offsets)
    if depth is None or math.isinf(depth):
        return problem, None
    return problem, round(depth / radius, 10)


def response_of(
    record: Record, plate: Surrogate | LayeredPlateModel, library: SurrogateLibrary
) -> GroundResponse:
    """Return the response of the ground at the sensors of a record, without geophones."""
    instrument = replace(record.instrument, geophone_natural_frequency=None, geophone_damping=None)
    offsets = [abs(sensor.offset) for sensor in record.nearest_first().sensors]
    return GroundResponse(plate, instrument, offsets, record.poisson_ratio, library)
