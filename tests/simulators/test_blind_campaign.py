"""Trace files and true values of the blind campaign."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inversion.effects import BY_NAME
from pfwd.files.traces import read_traces
from simulators.mesh import GroundError, SoilLayer
from tests.campaigns.blind import (
    DRAWN_LEVEL,
    SITES,
    SOIL_PROBABILITIES,
    Case,
    _draw_site,
    make_campaign,
    read_truth,
)
from tests.campaigns.effects.catalogue import CLEAN, EFFECTS
from tests.campaigns.effects.recording import Converter
from tests.campaigns.effects.response import stacked_ground
from tests.simulators.coarse import COARSE
from tests.simulators.test_simulated_traces import read

QUICK = ("clean", "sensor_lag", "permanent_set", "spring_rig", "gain_glitch", "plate_inertia")
ALLOWED = {
    "pfwd-traces",
    "plate_radius_m",
    "plate_mass_kg",
    "poisson_ratio",
    "bedrock_depth_m",
    "device",
    "calibrated",
}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("finite-elements")


@pytest.fixture(autouse=True)
def single_site(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offer one shallow site with coarse finite elements, as no test compares the motion."""
    monkeypatch.setattr("tests.campaigns.effects.response.RESOLUTION", COARSE)
    monkeypatch.setattr("tests.campaigns.blind.SITES", (SITES[3],))
    monkeypatch.setattr("tests.campaigns.blind.CONTACT_SITES", (SITES[3],))


def test_equal_seeds_give_equal_files(tmp_path: Path, cache: Path) -> None:
    names = ("first", "repeated", "changed")
    for name, seed in zip(names, (3, 3, 4), strict=True):
        make_campaign(tmp_path / name, seed=seed, per_case=1, cache=cache, only=QUICK, levels=(1,))
    files = [sorted((tmp_path / name / "traces").iterdir()) for name in names]
    texts = [[file.read_bytes() for file in some] for some in files]
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]
    assert read_truth(tmp_path / "first") == read_truth(tmp_path / "repeated")


def test_trace_files_do_not_reveal_the_truth(tmp_path: Path, cache: Path) -> None:
    cases = make_campaign(tmp_path, seed=5, per_case=2, cache=cache, only=QUICK)
    files = sorted((tmp_path / "traces").iterdir())
    assert [file.name for file in files] == [f"{n:04d}.csv" for n in range(1, len(files) + 1)]
    assert list((tmp_path / "traces").glob("*.json")) == []
    assert [case.file for case in cases] == [file.name for file in files]
    assert [case.key for case in cases] != sorted(case.key for case in cases)
    strict = (tmp_path / "truth" / "truth.json").read_text(encoding="utf-8")
    json.loads(strict, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert read_truth(tmp_path) == cases
    for case, file in zip(cases, files, strict=True):
        text = file.read_text(encoding="utf-8").replace("bedrock_depth_m", "")
        assert not [name for name in EFFECTS if name in text]
        header, columns, table = read(file)
        assert set(header) <= ALLOWED
        assert header["plate_radius_m"] == case.radius_m
        assert header.get("bedrock_depth_m", case.bedrock_depth_m) == case.bedrock_depth_m
        assert len(columns) == 3 + case.sensors
        assert set(table[:, 0]) == set(range(1, case.drops + 1))
        assert read_traces(file)


def test_a_campaign_replaces_only_files_of_a_former_campaign(tmp_path: Path, cache: Path) -> None:
    make_campaign(tmp_path, seed=1, per_case=4, cache=cache, only=("clean", "sensor_lag"))
    smaller = make_campaign(tmp_path, seed=1, per_case=1, cache=cache, only=("clean",))
    assert {file.name for file in (tmp_path / "traces").iterdir()} == {
        case.file for case in smaller
    }
    (tmp_path / "traces" / "mine.csv").touch()
    with pytest.raises(GroundError, match=r"mine\.csv"):
        make_campaign(tmp_path, seed=1, per_case=1, cache=cache, only=("clean",))
    with pytest.raises(GroundError, match="only"):
        make_campaign(tmp_path / "x", seed=1, only=("bedrok",))


def by_effect(cases: list[Case], name: str) -> list[Case]:
    return [case for case in cases if case.effect == name]


def test_every_strength_has_its_drops_and_a_fifth_of_the_points_is_clean(
    tmp_path: Path, cache: Path
) -> None:
    only = {CLEAN, "sensor_lag", "spring_rig", "gain_glitch"}
    cases = make_campaign(tmp_path, seed=2, per_case=8, cache=cache, only=only)
    for name in only - {CLEAN}:
        for level in range(3):
            assert sum(c.drops for c in by_effect(cases, name) if c.level == level) >= 8
    assert len(by_effect(cases, CLEAN)) / len(cases) == pytest.approx(0.2, abs=0.02)
    assert {case.drops for case in cases} == {1, 2, 3}
    assert {case.sensors for case in cases} == {1, 2, 3}
    assert {case.quantity for case in cases} == {"velocity", "displacement"}
    assert all(5e-4 <= case.noise <= 5e-3 for case in cases)


def test_the_points_of_a_survey_share_the_properties_of_the_device(
    tmp_path: Path, cache: Path
) -> None:
    only = ("geophone_response", "acquisition_filter", "plate_inertia")
    cases = make_campaign(tmp_path, seed=2, per_case=4, cache=cache, only=only)
    devices = {case.device for case in cases} - {None}
    assert len(devices) == 6  # two strengths each
    for device in devices:
        points = [case for case in cases if case.device == device]
        assert len(points) == 5
        assert len({json.dumps(case.parameters) for case in points}) == 1
        assert len({(case.radius_m, case.quantity, case.sensors) for case in points}) == 1
        headers = [read(tmp_path / "traces" / case.file)[0] for case in points]
        assert {header["device"] for header in headers} == {device}
        assert len({header["plate_mass_kg"] for header in headers}) == 1
        assert len({case.modulus_pa for case in points}) == 5


def test_undeclared_mass_and_depth_are_only_in_the_truth(tmp_path: Path, cache: Path) -> None:
    only = ("bedrock", "plate_inertia")
    cases = make_campaign(tmp_path, seed=2, per_case=1, cache=cache, only=only, levels=(2,))
    (rock,) = by_effect(cases, "bedrock")
    header, _, _ = read(tmp_path / "traces" / rock.file)
    assert header.get("bedrock_depth_m", math.inf) == math.inf
    assert rock.bedrock_depth_m == rock.parameters["depth_m"] == pytest.approx(0.5)
    (heavy,) = by_effect(cases, "plate_inertia")
    header, _, _ = read(tmp_path / "traces" / heavy.file)
    assert heavy.parameters["mass_kg"] == pytest.approx(0.5 * float(str(header["plate_mass_kg"])))


def test_every_effect_can_be_simulated_with_finite_samples(tmp_path: Path, cache: Path) -> None:
    costly = {"layer", "layer:two", "stress_dependence:between_drops", "rough_contact"}
    costly |= {"damping_law", "modulus_gradient"}
    only = sorted(set(EFFECTS) - costly)
    cases = make_campaign(tmp_path, seed=9, per_case=1, cache=cache, only=only, levels=(2,))
    assert {case.key for case in cases} == set(only)
    for case in cases:
        _, _, table = read(tmp_path / "traces" / case.file)
        assert np.all(np.isfinite(table))
        assert np.max(np.abs(table[:, 3:])) < 10.0


def test_stacked_layers_have_the_ratios_to_the_ground_below() -> None:
    below = SoilLayer(40e6, 5e4, 1900.0, 0.35)
    ground = stacked_ground(below, [(1.4**2, 0.15), (1.4, 0.3)])
    assert [layer.modulus for layer in ground.layers] == pytest.approx([78.4e6, 56e6, 40e6])
    assert [layer.viscosity for layer in ground.layers] == pytest.approx([9.8e4, 7e4, 5e4])
    assert [layer.thickness for layer in ground.layers] == [0.15, 0.3, math.inf]


@pytest.mark.slow
def test_effects_with_separate_finite_elements_can_be_simulated(
    tmp_path: Path, cache: Path
) -> None:
    only = ("layer", "stress_dependence:between_drops", "rough_contact")
    cases = make_campaign(tmp_path, seed=1, per_case=1, cache=cache, only=only, levels=(2,))
    (layer,), (stress,), (contact,) = (by_effect(cases, key.partition(":")[0]) for key in only)
    assert layer.sensors >= 2
    assert layer.parameters["ratio"] == 2.5
    _, _, table = read(tmp_path / "traces" / layer.file)
    assert np.all(np.isfinite(table))
    assert contact.parameters["stiffness_factor"] == pytest.approx(0.89, abs=0.02)
    moduli = stress.parameters["moduli_pa"]
    assert isinstance(moduli, list)
    assert stress.modulus_pa == moduli[-1] == max(moduli)
    assert moduli[0] < 0.95 * moduli[-1]


def test_effects_are_known_if_a_diagnosis_can_name_them() -> None:
    nameable = {*BY_NAME, CLEAN, "false_trigger"}  # drops with false triggers are rejected
    for effect in EFFECTS.values():
        assert effect.is_in_vocabulary == (effect.name in nameable) or effect.group == "soil"


def test_noise_has_the_stated_size_and_colour() -> None:
    generator = np.random.default_rng(1)
    converter = Converter("velocity", 1e-3, 0.8, 2, 16)
    noise = converter.noise_of((2, 40_000), generator)
    np.testing.assert_allclose(np.std(noise, axis=1), 1, rtol=0.03)
    assert np.corrcoef(noise[0, 1:], noise[0, :-1])[0, 1] == pytest.approx(0.8, abs=0.02)


def test_soils_of_the_campaign_have_the_stated_shares() -> None:
    generator = np.random.default_rng(1)
    drawn = [_draw_site(SITES, generator).ground.soil for _ in range(2000)]
    for soil, share in SOIL_PROBABILITIES.items():
        assert drawn.count(soil) / 2000 == pytest.approx(share, abs=0.03)
    assert sum(SOIL_PROBABILITIES.values()) == pytest.approx(1)
    rigid = [site for site in SITES if math.isfinite(site.depth)]
    assert "growth" not in {_draw_site(rigid, generator).ground.soil for _ in range(50)}


@pytest.fixture
def unmodelled_soils(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shallow sites, which are quick to compute."""
    quick = replace(SITES[3], modulus=30e6, viscosity=0.0)
    sites = (replace(quick, quality=10.0), replace(quick, growth=0.4), SITES[3])
    monkeypatch.setattr("tests.campaigns.blind.SITES", sites)


def test_the_truth_names_the_soil_and_its_equivalent_modulus(
    tmp_path: Path, cache: Path, unmodelled_soils: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EFFECTS, "damping_law", replace(EFFECTS["damping_law"], strengths=(10.0,)))
    monkeypatch.setitem(
        EFFECTS, "modulus_gradient", replace(EFFECTS["modulus_gradient"], strengths=(0.4,))
    )
    only = ("clean", "damping_law", "modulus_gradient")
    cases = make_campaign(tmp_path, seed=3, per_case=1, cache=cache, only=only)
    assert read_truth(tmp_path) == cases
    (damped,), (grown,) = by_effect(cases, "damping_law"), by_effect(cases, "modulus_gradient")
    assert {case.soil for case in by_effect(cases, CLEAN)} == {"kelvin-voigt"}
    assert (damped.group, damped.soil) == ("soil", "constant-q")
    assert (grown.group, grown.soil) == ("soil", "growth")
    law = damped.soil_parameters
    assert law["quality"] == 10.0
    _, _, table = read(tmp_path / "traces" / damped.file)
    load = table[table[:, 0] == damped.drops, 2]
    time = table[table[:, 0] == damped.drops, 1]
    pulse = math.pi * np.trapezoid(np.maximum(load, 0), time) / (2 * np.max(load))
    ratio = 1 / (2 * pulse) / float(str(law["reference_hz"]))
    expected = float(str(law["modulus_at_reference_pa"])) * ratio ** (2 * math.atan(0.1) / math.pi)
    assert damped.modulus_pa == pytest.approx(expected, rel=2e-3)
    growth = grown.soil_parameters
    assert growth["growth_depth_m"] == pytest.approx(0.15 / 0.4)
    surface = float(str(growth["surface_modulus_pa"]))
    assert grown.modulus_pa is not None
    assert 1.1 * surface < grown.modulus_pa < 1.6 * surface


def test_drawn_strengths_are_in_the_range_and_differ(tmp_path: Path, cache: Path) -> None:
    only = ("sensor_lag", "gain_glitch")
    cases = make_campaign(tmp_path, seed=3, per_case=4, cache=cache, only=only, drawn=True)
    for key in only:
        points = by_effect(cases, key)
        low, _, high = EFFECTS[key].strengths
        assert all(low <= case.strength <= high for case in points)
        assert len({case.strength for case in points}) == len(points) > 1
        assert {(case.level, case.device) for case in points} == {(DRAWN_LEVEL, None)}
