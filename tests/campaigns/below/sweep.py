"""Which faults are tried: every call of a run that went well, and then many more."""

from collections.abc import Iterator, Mapping

import numpy as np

from tests.campaigns.below.shim import CALLS, FOR_EVER, KINDS, SHARE, WRITING, Fault

_FULL = ("ENOSPC", "EDQUOT")
_GONE = ("EIO", "ESTALE")
ERRORS: Mapping[str, tuple[str, ...]] = {
    "open": (*_GONE, "EMFILE", "EACCES"),
    "create": (*_GONE, *_FULL, "EROFS", "EMFILE"),
    "read": _GONE,
    "write": (*_GONE, *_FULL, "EROFS", "EFBIG"),
    "fsync": (*_GONE, *_FULL, "EROFS"),
    "fdatasync": (*_GONE, *_FULL, "EROFS"),
    "truncate": (*_GONE, "EROFS"),
    "rename": (*_GONE, *_FULL, "EROFS"),
    "link": (*_GONE, *_FULL, "EROFS"),
    "unlink": (*_GONE, "EROFS"),
    "mkdir": (*_GONE, *_FULL, "EROFS"),
    "stat": _GONE,
    "fstat": _GONE,
    "lock": (*_GONE, "ENOLCK"),
    "list": (*_GONE, "EMFILE"),
    "close": (*_GONE, *_FULL),
    "space": _GONE,
}
"""What a system says of each call: a failing disk, a full one, one that is read-only, a folder over
the network that is gone, a process with too many open files."""

OFTEN = (1, 1, 2, 5, FOR_EVER, FOR_EVER)
"""In a row: most faults are once or for ever."""

EVERYWHERE = 0.15
"""Share of the faults after which every writing call on every file fails."""

Counts = Mapping[tuple[str, str], int]


def faults(counts: Counts, number: int, rng: np.random.Generator) -> list[Fault]:
    """So many faults: each call that was counted comes once before others are drawn anew.

    Parameters
    ----------
    counts : mapping of (call, kind) to int
        Of a run without a fault.
    number : int
    rng : Generator

    Returns
    -------
    list of Fault
        In an order in which the first few are as unlike as can be.
    """
    places = [(call, kind, at) for (call, kind), count in counts.items() for at in range(count)]
    order = [places[int(n)] for n in rng.permutation(len(places))]
    classes = list(counts)
    # One of every class first, so that a short run meets all of them.
    firsts = {(call, kind): (call, kind, at) for call, kind, at in order}
    order = [*firsts.values(), *(place for place in order if place not in firsts.values())]
    writing = sum(count for (call, _), count in counts.items() if call in WRITING)
    found: list[Fault] = []
    for call, kind, at in _drawn(order, classes, counts, rng):
        if len(found) == number:
            break
        if rng.random() < EVERYWHERE:
            error = str(rng.choice(("EIO", "ENOSPC", "EROFS", "ESTALE", "EDQUOT")))
            at = int(rng.integers(1, writing + 1))
            times = int(rng.choice(np.array([20, FOR_EVER])))
            found.append(Fault(WRITING, KINDS, at, times, error))
        else:
            found.append(_fault(call, kind, at + 1, rng))
    return found


def _drawn(
    order: list[tuple[str, str, int]],
    classes: list[tuple[str, str]],
    counts: Counts,
    rng: np.random.Generator,
) -> Iterator[tuple[str, str, int]]:
    yield from order
    while True:
        call, kind = classes[int(rng.integers(len(classes)))]
        yield call, kind, int(rng.integers(counts[call, kind]))


def _fault(call: str, kind: str, at: int, rng: np.random.Generator) -> Fault:
    error = str(rng.choice(ERRORS[call]))
    times = OFTEN[int(rng.integers(len(OFTEN)))]
    mode, amount = "error", 0
    chance = rng.random()
    if call == "write" and chance < 0.6:
        mode = "torn" if chance < 0.4 else "short"
        # A few bytes, which may end within a header, or a share of all.
        amount = int(rng.choice((1, 7, 44, 48, 60, SHARE + 300, SHARE + 900, SHARE + 999)))
        if mode == "short" and times == FOR_EVER and amount < SHARE:
            amount = 64  # one byte a call would only take long
    elif call in ("fsync", "fdatasync") and chance < 0.6:
        mode = "forget"
    elif call not in ("read", "stat", "fstat", "list", "space") and chance > 0.8:
        mode = "done"
    return Fault((call,), (kind,), at, times, error, mode, amount)


assert set(ERRORS) == set(CALLS)
