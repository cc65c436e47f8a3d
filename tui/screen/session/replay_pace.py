"""How fast a replay goes: set by keys, told in words."""

from pfwd.session.replay import Pace

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Of a replay, times real time."""


def pace_text(pace: Pace | None) -> str:
    """How fast a replay goes; empty when nothing is replayed."""
    if pace is None:
        return ""
    speed = "as fast as possible" if pace.speed == 0 else f"{pace.speed:g} x"
    return f"PAUSED ({speed})" if pace.paused else f"speed {speed}"


def pause_or_go_on(pace: Pace) -> None:
    """The one that it does not do now."""
    if pace.paused:
        pace.go_on()
    else:
        pace.pause()


def one_more(pace: Pace) -> None:
    """One drop more, then a pause."""
    if not pace.paused:
        pace.pause()
    pace.step()


def change_speed(pace: Pace, step: int) -> None:
    """Faster or slower by so many steps."""
    near = min(range(len(SPEEDS)), key=lambda k: abs(SPEEDS[k] - (pace.speed or SPEEDS[-1])))
    pace.speed = SPEEDS[min(max(near + step, 0), len(SPEEDS) - 1)]
