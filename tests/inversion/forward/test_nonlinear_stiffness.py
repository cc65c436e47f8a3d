"""Ground with a nonlinear static resistance against closed forms and integrations."""

from dataclasses import replace

import numpy as np
import pytest

from inversion.arrays import FloatArray
from inversion.forward import nonlinear_stiffness
from inversion.forward.nonlinear_stiffness import (
    NonlinearStiffness,
    _march,
    _resistance,
    effective_force,
    forces_nearby,
    hat_response,
    secant,
)

TIME = np.arange(600) * 1e-4
PULSE = np.where(TIME < 0.02, np.sin(np.pi * TIME / 0.02) ** 2, 0.0)


def rod(step: float, count: int, stiffness: float, damper: float) -> np.ndarray:
    """Hat response of a spring and a damper side by side: w = (1 - exp(-k t / c)) / k."""
    time = step * np.arange(count)
    rate = stiffness / damper
    ramp = (time - (1 - np.exp(-rate * time)) / rate) / stiffness
    return hat_response(ramp[None], step)


def test_a_linear_resistance_leaves_the_load_unchanged() -> None:
    hats = rod(1e-4, 600, 2e7, 1e5)
    load = 8000.0 * PULSE
    force, _ = effective_force(hats[0], load, NonlinearStiffness(), 2e7, 4e-4)
    np.testing.assert_allclose(force, load, atol=1e-3)


PULLED = [
    NonlinearStiffness(0.0, 1.1, 0.02, tension_share=0.25),
    NonlinearStiffness(0.0, 1.0, 0.0, tension_share=0.4),
    NonlinearStiffness(0.2, 1.4, 0.1, rest=0.05, tension_share=0.6),
]


STIFFNESS, DAMPER, REFERENCE = 2e7, 3e4, 4e-4


def integrated(law: NonlinearStiffness, load: np.ndarray) -> list[float]:
    """Displacement of a spring with this law beside a damper, in small steps.

    (w + w0)^p - w0^p in loading; back from the peak the same curve with another exponent, and part
    of it where it is pulled. Relieved of a quarter of w0 it goes on along its tangent.
    """
    p, x0, fine = 1 / (1 - law.stress_exponent), law.rest, 50

    def curve(x: float, power: float, rest: float) -> float:
        place, edge = x + rest, 0.75 * rest
        bent = max(place, edge) if rest else place
        odd = np.sign(bent) * abs(bent) ** power
        if rest and place < edge:
            odd += power * edge ** (power - 1) * (place - edge)
        return float((odd - rest**power) / ((1 + rest) ** power - rest**power))

    w, peak, result = 0.0, 0.0, []
    for n in range(TIME.size):
        result.append(w)
        for part in range(fine):
            force = np.interp(TIME[n] + part * 1e-4 / fine, TIME, load)
            peak = max(peak, w)
            if w >= peak:
                answer = curve(w / REFERENCE, p, x0)
            else:
                x = (w / peak - law.unrecovered) / (1 - law.unrecovered)
                answer = curve(peak / REFERENCE, p, x0) * (law.tension_share if x < 0 else 1.0)
                answer *= curve(x, p * law.unloading_exponent, x0 * REFERENCE / peak)
            w += 1e-4 / fine * (force - STIFFNESS * REFERENCE * answer) / DAMPER
    return result


def solved_both_ways(law: NonlinearStiffness, load: np.ndarray, result: list[float]) -> None:
    """All samples at once and one after the other are what was integrated."""
    hats = rod(1e-4, 600, STIFFNESS, DAMPER)
    force, solved = effective_force(hats[0], load, law, STIFFNESS, REFERENCE)
    got = np.convolve(hats[0], force)[:600]
    np.testing.assert_allclose(got, result, atol=1e-2 * max(result))
    marched = _march(hats[0], load, law, STIFFNESS, REFERENCE)
    np.testing.assert_allclose(solved, marched, atol=1e-6 * max(result))


@pytest.mark.parametrize("law", PULLED)
def test_ground_that_is_pulled_gives_way(law: NonlinearStiffness) -> None:
    """Under a blow that ends in a pull."""
    load = 8000.0 * (PULSE - 0.2 * np.roll(PULSE, 200) * (TIME > 0.02))
    result = integrated(law, load)
    # It is pulled as far as half of the pull over what is left of the stiffness.
    assert min(result) < -0.1 / law.tension_share * REFERENCE
    solved_both_ways(law, load, result)


@pytest.mark.parametrize("tension_share", [0.2, 1.0])
def test_shorter_steps_converge_about_an_edge(
    tension_share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A way back that is infinitely steep at its end; one sample after the other takes longer."""
    law = NonlinearStiffness(0.0, 0.6, 0.1, tension_share=tension_share)
    hats, load = rod(1e-4, 600, 2e7, 3e4)[0], 8000.0 * (PULSE - 0.2 * np.roll(PULSE, 200))
    marched = _march(hats, load, law, 2e7, 4e-4)
    monkeypatch.setattr(nonlinear_stiffness, "_march", None)
    _, solved = effective_force(hats, load, law, 2e7, 4e-4)
    np.testing.assert_allclose(solved, marched, atol=1e-5 * marched.max())


def test_ground_that_is_pulled_less_is_no_straight_line() -> None:
    assert NonlinearStiffness().linear
    assert not NonlinearStiffness().has_unloading_path
    assert not NonlinearStiffness(stress_exponent=0.2).has_unloading_path
    for law in (NonlinearStiffness(tension_share=0.9), NonlinearStiffness(unrecovered=0.1)):
        assert law.has_unloading_path
        assert not law.linear


PUSHED = [
    NonlinearStiffness(0.55),
    NonlinearStiffness(-0.3),
    NonlinearStiffness(0.4, 1.5, 0.2),
    NonlinearStiffness(0.2, 3.0, 0.1),
    NonlinearStiffness(0.4, rest=0.05),
    NonlinearStiffness(0.4, 1.5, 0.2, rest=0.05),
    NonlinearStiffness(-0.3, 0.8, 0.0, rest=0.2),
]


@pytest.mark.parametrize("law", PUSHED)
def test_nonlinear_ground_follows_its_equation_of_motion(law: NonlinearStiffness) -> None:
    load = 8000.0 * PULSE
    solved_both_ways(law, load, integrated(law, load))


@pytest.mark.parametrize("rest", [0.0, 0.05, 0.3])
def test_the_secant_is_force_over_displacement(rest: float) -> None:
    law = NonlinearStiffness(0.4, rest=rest)
    # So slow that nothing is radiated.
    hats = rod(1.0, 400, 2e7, 1e3)
    load = 8000.0 * np.sin(np.linspace(0, np.pi / 2, 400)) ** 2
    force, _ = effective_force(hats[0], load, law, 2e7, 4e-4)
    got = np.convolve(hats[0], force)[:400]
    for n in (80, 200, 399):
        expected = load[n] / got[n] / 2e7
        assert secant(law, load[n] / 8000.0) == pytest.approx(expected, rel=0.01)
    if rest == 0.0:
        assert secant(law, 0.25) == pytest.approx(0.25**0.4)


@pytest.mark.parametrize("peak", [1e-24, 1e-12, 1e-6])
def test_the_way_back_of_ground_that_hardly_moved_is_a_straight_line(peak: float) -> None:
    """Far below the displacement of the stress at rest nothing bends."""
    law = NonlinearStiffness(0.3, 2.0, 0.0, rest=0.3)
    w = peak * np.array([0.0, 1.0, 0.5])
    force, _, _ = _resistance(w, 1, law, 2e7, 4e-4)
    assert force[2] == pytest.approx(0.5 * force[1], rel=0.01)


# --- nonlinear resistance ------------------------------------------------------------------------


def solved(
    hats: FloatArray, load: FloatArray, law: NonlinearStiffness, stiffness: float
) -> FloatArray:
    """Twice, so that Newton's method leaves nothing."""
    _, w = effective_force(hats, load, law, stiffness, 4e-4)
    force, _ = effective_force(hats, load, law, stiffness, 4e-4, w)
    return force


LAWS = [
    NonlinearStiffness(0.4, 1.5, 0.2),
    NonlinearStiffness(-0.3),
    NonlinearStiffness(0.0, 1.3, 0.0),
    NonlinearStiffness(0.0, 1.1, 0.05, tension_share=0.4),
    NonlinearStiffness(0.2, 1.4, 0.1, rest=0.05, tension_share=0.6),
    NonlinearStiffness(),
]


@pytest.mark.parametrize("law", LAWS)
def test_forces_of_neighbouring_grounds_agree_with_solutions(law: NonlinearStiffness) -> None:
    # A blow that ends in a pull.
    load, stiffness, step = 8000.0 * (PULSE[:300] - 0.2 * np.roll(PULSE, 180)[:300]), 2e7, 1e-4
    hats = rod(1e-4, 300, stiffness, 4e4)[0]
    _, w = effective_force(hats, load, law, stiffness, 4e-4)
    _, w = effective_force(hats, load, law, stiffness, 4e-4, w)
    force_at_start = solved(hats, load, law, stiffness)
    nearby = [
        (rod(1e-4, 300, stiffness * (1 + step), 4e4)[0], law, stiffness * (1 + step)),
        (rod(1e-4, 300, stiffness, 4e4 * (1 + step))[0], law, stiffness),
        (hats, replace(law, stress_exponent=law.stress_exponent + step), stiffness),
        (hats, replace(law, unloading_exponent=law.unloading_exponent + step), stiffness),
    ]
    if law.stress_exponent >= 0.0:
        # Softening ground is infinitely steep at rest: when that moves, one step cannot follow.
        nearby.append((hats, replace(law, unrecovered=law.unrecovered + step), stiffness))
    if law.rest:
        nearby.append((hats, replace(law, rest=law.rest + step), stiffness))
    if law.tension_share != 1.0:
        nearby.append((hats, replace(law, tension_share=law.tension_share + step), stiffness))
    result = forces_nearby(
        hats,
        load,
        (law, stiffness, 4e-4),
        w,
        [(hats_nearby, changed, k, 4e-4) for hats_nearby, changed, k in nearby],
    )
    assert result.shape == (len(nearby), 300)
    # Forces near rest, where softening ground is steep, are told by what they move.
    still = np.convolve(hats, force_at_start)[:300]
    for computed, (hats_nearby, changed, k) in zip(result, nearby, strict=True):
        expected = np.convolve(hats_nearby, solved(hats_nearby, load, changed, k))[:300] - still
        assert np.abs(expected).max() > 1e-6 * still.max()
        error = np.abs(np.convolve(hats_nearby, computed)[:300] - still - expected).max()
        assert error < 0.01 * np.abs(expected).max() + 1e-8 * still.max()
