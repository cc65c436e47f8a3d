"""Inversion of an archive by the workers of an existing dask cluster (extra ``cluster``).

A scheduler and its workers have to be trusted: unpickling their messages can run any code on this
computer, and they run the code that is sent to them. With a ``tls://`` address certificates decide
which computers take part; see docs/security.md.
"""

import contextlib
import ipaddress
import socket
import ssl
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from importlib import import_module
from typing import Any
from urllib.parse import SplitResult, urlsplit

from pfwd.analysis.options import AnalysisOptions
from pfwd.archive.work import ArchiveWorkers, Batch, SourceOutcome
from pfwd.errors import OptionError, SurveyError, how_to_install, quote, refusal
from pfwd_device.recording.drop_file import software_version

_CONNECT_TIMEOUT_S = 20.0
_FIRST_WORKER_TIMEOUT_S = 60.0
"""Time for the first worker to connect: a cluster may start its workers on request only."""

_N_BATCHES_PER_THREAD = 2
"""Batches submitted for each thread of the cluster: one in work and one waiting."""

_PROTOCOLS = ("tcp", "tls", "ws", "wss", "ucx")
"""Protocols that dask offers between computers."""

_PROTECTED_PROTOCOLS = ("tls", "wss", "inproc")
"""Protocols of dask that require certificates (tls, wss) or stay within this process (inproc)."""

_CERTIFICATE_KEYS = "distributed.comm.tls: ca-file, client.cert and client.key (docs/security.md)"
"""Settings of dask for this computer's certificate and for the authority that signs all of them."""


def protection_warning(scheduler: str) -> str | None:
    """Return a warning if no certificates protect the connection to a scheduler; None: protected.

    Connections within this computer need no certificates.

    Parameters
    ----------
    scheduler : str
        Address, such as ``tcp://host:8786``.

    Examples
    --------
    >>> protection_warning("tls://head-node:8786"), protection_warning("tcp://127.0.0.1:8786")
    (None, None)
    """
    address = _parts_of(scheduler)
    host = address.hostname or ""
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
    if loopback or address.scheme in _PROTECTED_PROTOCOLS:
        return None
    return (
        f"--scheduler {scheduler}: without certificates anyone who reaches the cluster, or the "
        f"network in between, can run programs on it and here; use tls://{address.netloc} with "
        "dask's certificates (docs/security.md), or a network that you trust"
    )


def _parts_of(scheduler: str) -> SplitResult:
    """Return the parts of an address; raise OptionError if dask does not accept it."""
    try:
        parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        is_remote = parts.scheme in _PROTOCOLS and parts.path in ("", "/")
        # A scheduler in this process, started by a script, has no port.
        if parts.scheme == "inproc" or (is_remote and parts.hostname and parts.port):
            return parts
    except ValueError:  # a port out of range, or an IPv6 address without its bracket
        pass
    expected, hint = (
        "an address like tcp://host:8786",
        "the scheduler prints its own when it starts",
    )
    raise OptionError(refusal(f"--scheduler {scheduler}", expected, quote(scheduler), hint))


def check_address(scheduler: str) -> None:
    """Raise an error for an invalid address of a scheduler, or a host that cannot be resolved.

    Without this check dask would try for most of a minute and then print a traceback.

    Raises
    ------
    OptionError
    """
    parts = _parts_of(scheduler)
    if parts.scheme == "inproc":
        return
    try:
        socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as err:
        raise OptionError(
            f"--scheduler {scheduler}: host {parts.hostname}: not found "
            f"({getattr(err, 'strerror', None) or err}). Check the name and the network, or give "
            "its IP address"
        ) from err


class ClusterWorkers(ArchiveWorkers):
    """Workers of a dask cluster; when one is lost, another one repeats its batch.

    The workers need the same version of this program and must see the sources under the same paths.
    One thread for each worker is best: the inversion holds Python's global lock half of the time.

    Parameters
    ----------
    options : AnalysisOptions
    scheduler : str
        Address, such as ``tcp://host:8786``, or ``tls://host:8786`` with the certificates that dask
        is configured with.

    Raises
    ------
    OptionError
        If ``distributed`` is not installed, the address is invalid, or it needs certificates and
        none are configured.
    SurveyError
        If no scheduler or no worker responds, or workers have another version of this program.
    """

    def __init__(self, options: AnalysisOptions, scheduler: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as err:
            hint = f"{how_to_install('cluster')}, or --jobs N without a cluster"
            raise OptionError(
                refusal("--scheduler", "the Python package distributed", "none", hint)
            ) from err
        check_address(scheduler)
        super().__init__(options)
        self._where = f"--scheduler {scheduler}"
        security = distributed.Security()  # as dask is configured
        self._check_certificates(security, scheduler)
        try:
            self._client: Any = distributed.Client(
                scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False, security=security
            )
        except (ValueError, RuntimeError) as err:
            expected = "an address like tcp://host:8786"
            raise OptionError(refusal(self._where, expected, str(err))) from err
        except (OSError, TimeoutError) as err:
            refused = _refused_certificate(err)
            if refused is not None:
                expected, hint = "a scheduler whose certificate fits", f"see {_CERTIFICATE_KEYS}"
                raise SurveyError(refusal(self._where, expected, refused, hint)) from err
            hint = (
                "check that it is running, uses this protocol and can be reached from this computer"
            )
            raise SurveyError(refusal(self._where, "a scheduler", "no answer", hint)) from err
        self._executor = self._client.get_executor(pure=False)
        try:
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """Yield the outcomes of each batch when it is complete, in any order.

        Raises
        ------
        SurveyError
            If the connection to the cluster is lost, or workers die one after the other.
        """
        try:
            yield from super().run(batches)
        except (OSError, TimeoutError, CancelledError) as err:
            raise self._lost(str(err) or type(err).__name__) from err

    def close(self) -> None:
        """Disconnect from the cluster; batches that it is working on are abandoned."""
        # The cluster may be gone; there is nothing left to do then.
        with contextlib.suppress(Exception):
            self._client.close(timeout=5.0)

    def _check_certificates(self, security: Any, scheduler: str) -> None:
        """Raise an error for a tls address without certificates.

        An address without tls is an error if dask is configured to require encryption.
        """
        if not scheduler.startswith(("tls://", "wss://")):
            if security.require_encryption and not scheduler.startswith("inproc://"):
                expected = "an address like tls://host:8786"
                hint = "dask is configured to require encryption"
                raise OptionError(refusal(self._where, expected, "a plain one", hint))
            return
        try:
            if security.get_connection_args("client").get("ssl_context") is not None:
                return
            problem = "none"
        except (OSError, ValueError) as err:  # errors of ssl are OSErrors
            problem = str(err)
        expected = f"certificates in {_CERTIFICATE_KEYS}"
        raise OptionError(refusal(self._where, expected, problem))

    def _max_batches(self) -> int:
        # Computed each time, because clusters grow.
        threads: int = sum(self._client.nthreads().values())
        return _N_BATCHES_PER_THREAD * max(1, threads)

    def _outcomes(self, request: Future[list[SourceOutcome]]) -> list[SourceOutcome] | None:
        try:
            return request.result()
        except Exception as err:
            if type(err).__name__ == "KilledWorker":  # an error of dask
                return None
            raise self._lost(str(err) or type(err).__name__) from err

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_TIMEOUT_S)
        except TimeoutError as err:
            problem = f"none within {_FIRST_WORKER_TIMEOUT_S:.0f} s"
            raise SurveyError(refusal(self._where, "a worker", problem)) from err
        hint = "install the same one everywhere"
        ours = software_version()
        try:
            versions = self._client.run(software_version)
        except Exception as err:
            expected = f"workers with pfwd {ours}"
            raise SurveyError(refusal(self._where, expected, str(err), hint)) from err
        for worker, version in versions.items():
            if version != ours:
                actual = f"{version} on {worker}"
                raise SurveyError(refusal(self._where, f"pfwd {ours} on all", actual, hint))

    def _lost(self, problem: str) -> SurveyError:
        hint = "repeat the command: it continues where this one ended"
        return SurveyError(refusal(self._where, "a cluster that responds", problem, hint))


def _refused_certificate(err: BaseException | None) -> str | None:
    """Return the reason for which a certificate was refused; None: the error has another cause."""
    while err is not None:
        if isinstance(err, ssl.SSLError):
            return err.verify_message if isinstance(err, ssl.SSLCertVerificationError) else str(err)
        err = err.__cause__ or err.__context__
    return None
