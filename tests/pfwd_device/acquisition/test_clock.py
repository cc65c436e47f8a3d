"""The clock of the instrument, with delays as a cable and a busy computer make them."""

import numpy as np
import pytest

from pfwd_device.acquisition.clock import _MAX_BINS, DeviceClock, LossWatch


def run(
    clock: DeviceClock,
    seconds: float,
    *,
    speed: float = 1.0,
    begin: float = 1000.0,
    device: float = 5.0,
    jitter: float = 0.002,
    seed: int = 1,
    every: float = 0.02,
) -> None:
    """Messages every 20 ms, late by an exponential delay and now and then by much more."""
    generator = np.random.default_rng(seed)
    sent = np.arange(0.0, seconds, every)
    delay = generator.exponential(jitter, sent.size)
    delay += np.where(generator.random(sent.size) < 0.02, generator.uniform(0, 0.3, sent.size), 0)
    host = np.maximum.accumulate(sent + delay)
    for then, now in zip(sent, host, strict=True):
        clock.add(device + speed * float(then), begin + float(now))


@pytest.mark.parametrize("ppm", [-80.0, 0.0, 40.0, 300.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_drift_is_estimated(ppm: float, seed: int) -> None:
    clock = DeviceClock()
    run(clock, 120.0, speed=1 + ppm / 1e6, seed=seed)
    assert clock.is_real_time
    assert clock.drift_ppm == pytest.approx(ppm, abs=15)
    assert clock.jumps == 0


def test_memory_is_bounded() -> None:
    clock = DeviceClock()
    run(clock, 3000.0, speed=1 + 25e-6, every=0.2)
    assert len(clock._bins) <= _MAX_BINS
    assert clock.drift_ppm == pytest.approx(25, abs=2)


@pytest.mark.parametrize("speed", [0.1, 5.0, 100.0])
def test_another_speed_is_no_drift_and_no_jump(speed: float) -> None:
    clock = DeviceClock()
    run(clock, 20.0, speed=speed)
    assert clock.speed == pytest.approx(speed, rel=0.02)
    assert clock.is_real_time is False
    assert clock.drift_ppm is None
    assert clock.jumps == 0


@pytest.mark.parametrize("jump", [-3600.0, -3.0, 2.0, 3600.0])
def test_a_jump_is_counted_once(jump: float) -> None:
    clock = DeviceClock()
    run(clock, 20.0)
    run(clock, 40.0, begin=1020.0, device=25.0 + jump)
    assert clock.jumps == 1
    assert clock.drift_ppm == pytest.approx(0, abs=50)


def test_a_slow_backward_step_is_noticed_by_its_persistence() -> None:
    """The first message after it is of another kind, so that no time runs backward."""
    clock = DeviceClock()
    run(clock, 20.0)
    for step in range(500):
        clock.add(23.0 + 0.02 * step, 1020.0 + 0.02 * step, "another")
    assert clock.jumps == 1


def test_a_pause_and_late_arrivals_are_no_jump() -> None:
    clock = DeviceClock()
    run(clock, 20.0)
    run(clock, 20.0, begin=1050.0, device=55.0)
    for step in range(100):  # two seconds of messages, all at once
        clock.add(75.0 + 0.02 * step, 1072.0)
    run(clock, 20.0, begin=1072.0, device=77.0)
    assert clock.jumps == 0


def test_a_new_beginning_is_no_jump() -> None:
    clock = DeviceClock()
    run(clock, 20.0)
    clock.restart()
    run(clock, 20.0, begin=1020.0, device=0.0)
    assert clock.jumps == 0


@pytest.mark.parametrize(("step", "jumps"), [(0.4, 0), (0.7, 1), (-0.15, 0), (-0.3, 1)])
def test_a_jump_is_more_than_any_delay(step: float, jumps: int) -> None:
    """Forward by more than half a second, or backward by more than blocks overtake each other."""
    clock = DeviceClock()
    run(clock, 20.0)
    for k in range(100):
        clock.add(25.0 + step + 0.02 * k, 1020.0 + 0.02 * k)
    assert clock.jumps == jumps


def test_drift_is_reported_after_a_quarter_of_a_minute() -> None:
    clock = DeviceClock()
    assert (clock.speed, clock.is_real_time) == (None, None)
    run(clock, 14.0, jitter=1e-4)
    assert clock.is_real_time
    assert clock.drift_ppm is None
    run(clock, 3.0, begin=1014.0, device=19.0, jitter=1e-4)
    assert clock.drift_ppm is not None


@pytest.mark.parametrize(("speed", "real"), [(0.992, True), (1.008, True), (1.012, False)])
def test_a_hundredth_is_another_speed_on_purpose(speed: float, real: bool) -> None:
    clock = DeviceClock()
    run(clock, 20.0, speed=speed, jitter=1e-4)
    assert clock.is_real_time is real
    assert (clock.drift_ppm is not None) is real


def test_a_drift_that_changes_is_followed() -> None:
    clock = DeviceClock()
    run(clock, 15.5)
    assert clock.drift_ppm == pytest.approx(0, abs=60)
    run(clock, 45.0, speed=1 + 900e-6, begin=1015.5, device=20.5)
    assert clock.drift_ppm is not None
    assert clock.drift_ppm > 400


@pytest.mark.parametrize("speed", [0.95, 0.993, 1.0, 1.007, 1.05])
def test_a_steady_deviation_is_that_of_the_speed_after_15_s(speed: float) -> None:
    clock = DeviceClock()
    run(clock, 14.0, speed=speed)
    assert clock.steady_deviation is None
    run(clock, 4.0, speed=speed, begin=1014.0, device=5.0 + 14.0 * speed)
    assert clock.steady_deviation == pytest.approx(speed - 1, abs=5e-4)


@pytest.mark.parametrize("jump", [-0.4, -0.1, 0.2, 0.45])
def test_a_jump_of_a_clock_is_no_steady_deviation(jump: float) -> None:
    clock = DeviceClock()
    run(clock, 10.0)
    run(clock, 10.0, begin=1010.0, device=15.0 + jump)
    assert abs(clock.steady_deviation or 0.0) < 1e-3


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
