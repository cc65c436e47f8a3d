"""Files of laboratory programs with one array for each channel, read as columns with names.

A column map gives the columns their meaning, as with a delimited text.
"""

import contextlib
import importlib
import io
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pfwd.errors import TraceError, how_to_install, refusal
from pfwd.files.foreign.common import Values

TIME_NAME = "time"
"""Name of the first column, which is the time in s."""
FORMAT_BYTES = 32
"""Number of first bytes by which a format is recognised."""
MAX_SAMPLES = 20_000_000
"""Largest number of samples of all channels together."""


class NamedColumn(NamedTuple):
    """Channel of a file."""

    name: str
    unit: str
    """Unit as the file writes it; empty: the file has none."""
    values: Values


@dataclass(frozen=True, slots=True)
class LaboratoryFormat:
    """File format of a laboratory program."""

    name: str
    """Name for messages."""
    start: bytes
    """Pattern of the first bytes of a file."""
    read: Callable[[str], tuple[float | None, list[NamedColumn]]]
    """Function that returns sampling rate, Hz, or None if a channel has the time, and channels."""
    package: str = ""
    """Package of the extra `laboratory` that reads it; empty: it comes with this program."""


def laboratory_format(head: bytes) -> LaboratoryFormat | None:
    """Return the format of a file with these first bytes; None: no laboratory program wrote it."""
    return next((each for each in FORMATS if re.match(each.start, head, re.DOTALL)), None)


def read_laboratory(file: str, form: LaboratoryFormat) -> list[NamedColumn]:
    """Return the channels of a file, the time first.

    Parameters
    ----------
    file : str
    form : LaboratoryFormat
        Format of the file.

    Raises
    ------
    TraceError
        If the package for the format is missing, or the file is damaged or has no channel.
    """
    try:
        with _without_output():
            rate, columns = form.read(file)
    except ImportError as err:
        hint = how_to_install("laboratory")
        raise TraceError(refusal(file, f"the package {form.package}", "none", hint)) from err
    except TraceError:
        raise
    except Exception as err:  # readers raise any exception on damaged bytes
        detail = " ".join(str(err).split())[:80]
        actual = f"damaged or unknown content ({type(err).__name__}: {detail})"
        raise TraceError(refusal(file, f"a {form.name} file", actual)) from err
    lengths = {len(column.values) for column in columns}
    if not columns or 0 in lengths or sum(len(each.values) for each in columns) > MAX_SAMPLES:
        raise TraceError(refusal(file, "channels with samples", f"{len(columns)} channels"))
    if len(lengths) > 1:
        got = f"of {', '.join(map(str, sorted(lengths)))} samples"
        raise TraceError(refusal(file, "channels of equal length", got))
    if rate is None:
        return columns
    if not 0 < rate < np.inf:
        raise TraceError(refusal(file, "a sampling rate > 0 Hz", f"{rate:g}"))
    return [NamedColumn(TIME_NAME, "s", np.arange(lengths.pop()) / rate), *columns]


@contextlib.contextmanager
def _without_output() -> Iterator[None]:
    """Discard warnings of readers, which would stand between the lines of a command."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _vector(values: Any) -> Values:
    """Return values as floats; raise TraceError unless they are real numbers in one dimension."""
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        raise TraceError(f"expected real numbers in one dimension, got {array.dtype} {array.shape}")
    return array.astype(np.float64)


def _read_wav(file: str) -> tuple[float, list[NamedColumn]]:
    """Return the channels of a sound file; whole numbers become fractions of the full scale."""
    from scipy.io import wavfile

    rate, data = wavfile.read(file)
    table = np.atleast_2d(data.T).T
    scale, zero = 1.0, 0.0
    if table.dtype.kind in "iu":
        zero = 128.0 if table.dtype.kind == "u" else 0.0
        scale = float(2 ** (8 * table.dtype.itemsize - 1))
    values = (table.astype(np.float64) - zero) / scale
    return float(rate), [NamedColumn(f"channel {i}", "", v) for i, v in enumerate(values.T, 1)]


def _read_matlab(file: str) -> tuple[None, list[NamedColumn]]:
    """Return the vectors, and columns of matrices, of a MATLAB file up to version 7."""
    from scipy.io import loadmat

    return None, _arrays(loadmat(file))


def _read_matlab_hdf5(file: str) -> tuple[None, list[NamedColumn]]:
    """Return the vectors, and columns of matrices, of a MATLAB file of version 7.3."""
    import h5py

    with h5py.File(file, "r") as stream:
        # MATLAB stores matrices by columns, HDF5 by rows.
        datasets = {name: each for name, each in stream.items() if isinstance(each, h5py.Dataset)}
        return None, _arrays({name: np.asarray(each).T for name, each in datasets.items()})


def _arrays(arrays: Mapping[str, Any]) -> list[NamedColumn]:
    """Return the channels in arrays of numbers: those that have the most frequent length."""
    columns = []
    for name, array in arrays.items():
        if name.startswith("__") or not isinstance(array, np.ndarray) or array.ndim != 2:
            continue
        if array.dtype.kind not in "iuf" or array.size < 2:
            continue
        table = array.T if min(array.shape) == 1 and array.shape[0] == 1 else array
        for number, values in enumerate(table.T, start=1):
            title = f"{name}_{number}" if table.shape[1] > 1 else name
            columns.append(NamedColumn(title, "", _vector(values)))
    longest = max((len(column.values) for column in columns), default=0)
    return [column for column in columns if len(column.values) == longest]


def _read_tdms(file: str) -> tuple[float | None, list[NamedColumn]]:
    """Return the channels of a LabVIEW file; those of one sampling rate."""
    nptdms = importlib.import_module("nptdms")
    rates, columns = set(), []
    for group in nptdms.TdmsFile.read(file).groups():
        for channel in group.channels():
            if len(channel):
                unit = str(channel.properties.get("unit_string", ""))
                columns.append(NamedColumn(channel.name, unit, _vector(channel[:])))
                rates.add(channel.properties.get("wf_increment"))
    if len(rates) != 1:
        raise TraceError(refusal(file, "channels of one sampling rate", f"{len(rates)} rates"))
    step = rates.pop()
    return None if step is None else 1 / float(step), columns


def _read_seismic(file: str) -> tuple[float, list[NamedColumn]]:
    """Return the traces of a SEG-2 or miniSEED file, all of one sampling rate."""
    obspy = importlib.import_module("obspy")
    # From memory, because the reader leaves a damaged file open.
    traces = obspy.read(io.BytesIO(Path(file).read_bytes()))
    rates = {float(trace.stats.sampling_rate) for trace in traces}
    if len(rates) != 1:
        raise TraceError(refusal(file, "traces of one sampling rate", f"{len(rates)} rates"))
    names = [str(trace.stats.channel) or trace.id for trace in traces]
    if len(set(names)) < len(names) or not all(names):
        names = [f"trace {number}" for number in range(1, len(names) + 1)]
    columns = zip(names, traces, strict=True)
    return rates.pop(), [NamedColumn(name, "", _vector(trace.data)) for name, trace in columns]


FORMATS = (
    LaboratoryFormat("WAV", rb"(RIFF|RIFX|RF64)....WAVE", _read_wav),
    LaboratoryFormat("MATLAB 7.3", rb"MATLAB 7\.3 MAT-file", _read_matlab_hdf5),
    LaboratoryFormat("MATLAB", rb"MATLAB 5\.0 MAT-file", _read_matlab),
    LaboratoryFormat("TDMS", rb"TDSm", _read_tdms, "npTDMS"),
    LaboratoryFormat("SEG-2", rb"\x55\x3a|\x3a\x55", _read_seismic, "obspy"),
    LaboratoryFormat("miniSEED", rb"[0-9]{6}[DRQM]|MS\x03", _read_seismic, "obspy"),
)
"""Formats, recognised by their first bytes."""
