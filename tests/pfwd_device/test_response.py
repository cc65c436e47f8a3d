r"""The corrected trace against closed forms of a geophone's answer.

u'' + 2 h w u' + w^2 u = v'' with v a step of 1 at t = 0 has, for h < 1,
u = exp(-h w t) (cos(d t) - (h w / d) sin(d t)), d = w sqrt(1 - h^2); with v a unit impulse it is
delta(t) plus the derivative of that.
"""

import numpy as np
import pytest

from pfwd_device.response import correct_response

RATE = 20_000.0
TIME = np.arange(4000) / RATE


def step_answer(frequency: float, damping: float) -> np.ndarray:
    w = 2 * np.pi * frequency
    d = w * np.sqrt(1 - damping**2)
    swing = np.cos(d * TIME) - damping * w / d * np.sin(d * TIME)
    return np.asarray(np.exp(-damping * w * TIME) * swing)


def impulse_answer(frequency: float, damping: float) -> np.ndarray:
    """The answer to a unit impulse behind the impulse itself: the derivative of the above."""
    w = 2 * np.pi * frequency
    d = w * np.sqrt(1 - damping**2)
    cosine = -2 * damping * w
    sine = (2 * damping**2 * w**2 - w**2) / d
    decay = np.exp(-damping * w * TIME)
    return np.asarray(decay * (cosine * np.cos(d * TIME) + sine * np.sin(d * TIME)))


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.6), (10.0, 0.3), (4.5, 0.05)])
def test_a_step_comes_back(frequency: float, damping: float) -> None:
    corrected = correct_response(step_answer(frequency, damping), RATE, frequency, damping)
    np.testing.assert_allclose(corrected, 1.0, atol=2e-5)


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.6), (10.0, 0.3)])
def test_an_impulse_comes_back(frequency: float, damping: float) -> None:
    record = impulse_answer(frequency, damping)
    # The impulse itself is the first sample: half of its area lies before it (trapezoidal rule).
    record[0] = record[0] / 2 + 2 * RATE / 2
    corrected = correct_response(np.concatenate([[0.0], record]), RATE, frequency, damping)
    late = corrected[50:]
    early = np.abs(impulse_answer(frequency, damping)).max()
    assert np.abs(late).max() < 0.02 * early


def test_the_error_falls_with_the_square_of_the_step() -> None:
    errors = []
    for stride in (1, 2, 4):
        record = step_answer(30.0, 0.5)[::stride]
        errors.append(np.abs(correct_response(record, RATE / stride, 30.0, 0.5) - 1).max())
    assert errors[1] / errors[0] == pytest.approx(4, rel=0.1)
    assert errors[2] / errors[1] == pytest.approx(4, rel=0.1)
