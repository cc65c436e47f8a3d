"""Lost samples of an instrument that does not count them."""

import numpy as np
import pytest

from pfwd_device.acquisition.clock import LossWatch


@pytest.mark.parametrize("seed", range(6))
def test_a_loss_is_detected_once_and_a_busy_computer_is_not_a_loss(seed: int) -> None:
    rng = np.random.default_rng(seed)
    watch, losses = LossWatch(), []
    arrival = 0.0
    loss = float(rng.uniform(0.06, 0.5))
    for number in range(6000):
        sampled = number * 0.01
        delay = 0.002 + 0.005 * rng.random() + 50e-6 * sampled  # 50 ppm of difference of clocks
        if 20 < sampled < 22:
            delay += 0.3 * rng.random()  # busy
        counted = sampled - (loss if sampled > 40 else 0.0)
        arrival = max(arrival, sampled + delay)  # bytes arrive in their order
        losses.append(watch.add(counted, arrival))
    lost = [(number, each) for number, each in enumerate(losses) if each is not None]
    assert len(lost) == 1
    number, size = lost[0]
    assert 4000 < number < 4600
    assert size == pytest.approx(loss, abs=0.02)


@pytest.mark.parametrize("speed", [0.9, 0.96, 1.04])
def test_a_wrong_sampling_rate_is_no_loss(speed: float) -> None:
    watch = LossWatch()
    assert {watch.add(speed * number * 0.01, number * 0.01) for number in range(6000)} == {None}
