"""Records as surveys store them: one that cannot be read is an error of the survey."""

from dataclasses import dataclass
from typing import Self

from inversion.errors import RecordFormatError
from inversion.records import JsonRecord
from pfwd.errors import SurveyError


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredRecord(JsonRecord):
    """Record of a survey."""

    @classmethod
    def from_json(cls, written: object, where: str = "a stored record") -> Self:
        """Read the record from JSON, see `JsonRecord.from_json`.

        Raises
        ------
        SurveyError
            If it is no mapping.
        """
        try:
            return super(StoredRecord, cls).from_json(written, where)
        except RecordFormatError as err:
            raise SurveyError(str(err)) from err
