"""Points of one device whose deflection comes late."""

import pickle
from collections.abc import Iterator
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

from inversion.diagnosis.findings import PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.inference import structures
from inversion.inference.diagnose import diagnose_point
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.structures import Structure
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device import Channel, Drop
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilProfile

RADIUS = 0.15
DELAY = 6e-4
STEP = 2e-4


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Two points of one device whose deflection comes late, by whole samples."""
    folder = tmp_path_factory.mktemp("points")
    paths = []
    for number, (modulus, depth) in enumerate([(40e6, 1.0), (70e6, 1.5)]):
        ground = SoilProfile.uniform(modulus, 5e4, 1900.0, 0.35, depth)
        hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
        simulated = simulate_drop(
            ground, Plate(RADIUS, 10.0), hammer, duration=0.05, time_step=STEP
        )
        late = round(DELAY / STEP)
        moved = np.concatenate([np.zeros(100 + late), simulated.plate_displacement[:-late]])
        rng = np.random.default_rng(number)
        moved = moved + 5e-4 * moved.max() * rng.standard_normal(moved.size)
        load = np.concatenate([np.zeros(100), simulated.load])
        time = STEP * np.arange(-100, simulated.load.size)
        drop = Drop(1, time, load, (Channel(0.0, "displacement", moved),))
        setup = PointSetup(
            plate_radius=RADIUS,
            plate_mass=10.0,
            poisson_ratio=0.35,
            bedrock_depth=depth,
            device="late unit",
        )
        path = folder / f"point-{number}.csv"
        write_traces(path, TracePoint(str(path), setup, (drop,)))
        paths.append(str(path))
    return paths


@pytest.fixture(scope="session")
def diagnoses() -> dict[bytes, PointDiagnosis]:
    """Diagnoses of a test run, by their input."""
    return {}


@pytest.fixture(scope="module")
def computed_once(diagnoses: dict[bytes, PointDiagnosis]) -> Iterator[None]:
    """Compute the diagnosis of the same records with the same knowledge only once."""

    def diagnose(
        records: PointRecords, library: Any, instrument: InstrumentKnowledge, **options: Any
    ) -> PointDiagnosis:
        options = {"compare_declarations": False, **options}  # these take most of the time
        key = pickle.dumps((astuple(replace(records, name="")), astuple(instrument), options))
        if key not in diagnoses:
            diagnoses[key] = diagnose_point(records, library, instrument, **options)
        return replace(diagnoses[key], name=records.name)

    candidates: list[Structure] = [frozenset(), frozenset({"sensor_lag"})]
    with pytest.MonkeyPatch.context() as patch:
        # The choice among all structures takes most of the time.
        patch.setattr(structures, "candidate_structures", lambda contexts: candidates)
        patch.setattr("pfwd.analysis.diagnosis.shared_device.diagnose_point", diagnose)
        yield
