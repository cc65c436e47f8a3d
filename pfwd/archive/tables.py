"""Response tables of a worker, limited in number; loads numpy, hence a module of its own."""

from inversion import PlateProblem, SurrogateLibrary
from inversion.forward.surrogate import Surrogate


class BoundedLibrary(SurrogateLibrary):
    """Library that drops the table that was loaded first when there are too many.

    Parameters
    ----------
    max_tables : int
        Tables in memory; dropped ones are read from the disk again.
    """

    def __init__(self, max_tables: int) -> None:
        super().__init__()
        self._max_tables = max_tables

    def get(self, problem: PlateProblem, depth: float | None) -> Surrogate:
        """Return a response table, see :meth:`SurrogateLibrary.get`."""
        table = super().get(problem, depth)
        while len(self._surrogates) > self._max_tables:
            del self._surrogates[next(iter(self._surrogates))]
        return table
