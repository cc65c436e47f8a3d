"""The response tables of a worker, no more of them than memory is meant for."""

from inversion import PlateProblem, SurrogateLibrary
from inversion.forward.surrogate import Surrogate


class BoundedLibrary(SurrogateLibrary):
    """A library that forgets the table that was loaded first when there are too many.

    Parameters
    ----------
    most : int
        Tables kept in memory; what is forgotten is read from the disk again.
    """

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most = most

    def get(self, problem: PlateProblem, depth: float | None) -> Surrogate:
        """See :meth:`SurrogateLibrary.get`."""
        found = super().get(problem, depth)
        while len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
        return found
