"""Workers of an existing dask cluster; needs the package ``distributed`` (extra ``cluster``).

A scheduler and its workers have to be trusted: unpickling their messages can run any code here,
and they run the code that is sent to them. The certificates of a ``tls://`` address decide which
computers take part; see docs/security.md.
"""

from __future__ import annotations

import contextlib
import ipaddress
import re
import socket
import ssl
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pfwd.archive.work import Batch, SourceOutcome, invert_batch
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd_device.recording.drop_file import software_version

if TYPE_CHECKING:
    from pfwd.analysis.options import AnalysisOptions

_CONNECT_TIMEOUT_S = 20.0
_FIRST_WORKER_TIMEOUT_S = 60.0
"""Time for the first worker to connect; a cluster may start workers on request."""

_N_BATCHES_PER_THREAD = 2
"""Batches submitted for each thread of the cluster: one in work, one ready."""


_ADDRESS = re.compile(
    r"(?:(?P<protocol>[a-z]+)://)?(?:\[(?P<six>[0-9a-fA-F:.%\w]+)\]|(?P<name>[^\s:/\[\]]+))"
    r":(?P<port>[0-9]{1,6})/?"
)

_PROTOCOLS = ("tcp", "tls", "ws", "wss", "ucx")
"""Protocols of dask between computers."""

_PROTECTED_PROTOCOLS = ("tls", "wss", "inproc")
"""Protocols of dask that require certificates, or do not leave the program."""

_CERTIFICATE_KEYS = "distributed.comm.tls: ca-file, client.cert and client.key (docs/security.md)"
"""Settings of dask for its own certificate and for those that it accepts."""


def protection_warning(scheduler: str) -> str | None:
    """Return a warning if the connection to this address is not protected by certificates.

    Connections within this computer need none.

    Parameters
    ----------
    scheduler : str
        Address, as ``tcp://host:8786``.

    Examples
    --------
    >>> protection_warning("tls://head-node:8786"), protection_warning("tcp://127.0.0.1:8786")
    (None, None)
    """
    protocol, sign, rest = scheduler.rpartition("://")
    if sign and protocol in _PROTECTED_PROTOCOLS:
        return None
    host = rest.rpartition(":")[0].strip("[]") or rest
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host.lower() == "localhost"
    if loopback:
        return None
    return (
        f"--scheduler {scheduler}: without certificates anyone who reaches the cluster, or the "
        f"network in between, can run programs on it and here; use tls://{rest} with dask's "
        "certificates (docs/security.md), or a network that you trust"
    )


def check_address(scheduler: str) -> None:
    """Refuse a text that is no address of a scheduler, and a host that cannot be resolved.

    dask itself tries for most of a minute and prints a traceback at the end.

    Raises
    ------
    OptionError
    """
    where = f"--scheduler {scheduler}"
    if scheduler.startswith("inproc://"):  # of this program, by a script
        return
    parts = _ADDRESS.fullmatch(scheduler)
    if (
        parts is None
        or parts["protocol"] not in (None, *_PROTOCOLS)
        or not 0 < int(parts["port"]) <= 65_535
    ):
        expected = "an address like tcp://host:8786"
        hint = "the scheduler prints its own when it starts"
        raise OptionError(refusal(where, expected, "something else", hint))
    host = parts["six"] or parts["name"]
    try:
        socket.getaddrinfo(host, int(parts["port"]), type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as err:
        raise OptionError(
            f"{where}: host {host}: not found ({getattr(err, 'strerror', None) or err}). Check the "
            "name and the network, or give its IP address"
        ) from err


class ClusterWorkers:
    """Cluster that inverts batches; the batch of a lost worker is repeated by another one.

    Its workers have to run the same version of this program and see the sources under the same
    paths. One thread a worker is best: inverting holds Python's lock half of the time.

    Parameters
    ----------
    options : AnalysisOptions
    scheduler : str
        Address, as ``tcp://host:8786``, or ``tls://host:8786`` with the certificates that dask is
        configured with.

    Raises
    ------
    OptionError
        If ``distributed`` is not installed, the address is invalid, or it needs certificates and
        none are configured.
    SurveyError
        If there is no scheduler or no worker, or workers have another version of this program.
    """

    def __init__(self, options: AnalysisOptions, scheduler: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as err:
            hint = 'python -m pip install "pfwd[cluster]", or --jobs N without a cluster'
            raise OptionError(
                refusal("--scheduler", "the Python package distributed", "none", hint)
            ) from err
        check_address(scheduler)
        self._options = options
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
            hint = "is it running, does it speak this protocol, and can it be reached from here?"
            raise SurveyError(refusal(self._where, "a scheduler", "no answer", hint)) from err
        try:
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """Yield the outcomes of batches, see :class:`~pfwd.archive.work.Workers`.

        Raises
        ------
        SurveyError
            If the cluster is lost.
        """
        distributed: Any = import_module("distributed")
        waiting: list[Batch] = []
        submitted: dict[Any, Batch] = {}
        exhausted = False
        try:
            while True:
                while waiting or (not exhausted and len(submitted) < self._max_batches()):
                    batch = waiting.pop() if waiting else next(batches, None)
                    if batch is None:
                        exhausted = True
                        continue
                    future = self._client.submit(
                        invert_batch, list(batch.sources), self._options, pure=False
                    )
                    submitted[future] = batch
                if not submitted:
                    return
                with self._client.as_current():
                    completed = distributed.wait(
                        list(submitted), return_when="FIRST_COMPLETED"
                    ).done
                for future in completed:
                    batch = submitted.pop(future)
                    if future.status == "finished":
                        outcomes: list[SourceOutcome] = future.result()
                        yield outcomes
                        continue
                    if future.status != "error":
                        raise self._lost(f"a task that is {future.status}")
                    error = future.exception()
                    if not isinstance(error, distributed.scheduler.KilledWorker):
                        raise self._lost(f"{type(error).__name__}: {error}")
                    retries = batch.retries_after_death()
                    waiting += retries
                    if not retries:
                        yield batch.worker_failures()
        except (OSError, TimeoutError, distributed.CancelledError) as err:
            raise self._lost(str(err) or type(err).__name__) from err

    def close(self) -> None:
        """Leave the cluster; batches in work there are abandoned."""
        # A cluster that has gone cannot be left in good order.
        with contextlib.suppress(Exception):
            self._client.close(timeout=5.0)

    def _check_certificates(self, security: Any, scheduler: str) -> None:
        """Refuse a protected address without certificates, and a plain one if dask forbids it."""
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
        """Return the number of batches to have submitted; clusters grow, hence each time."""
        threads: int = sum(self._client.nthreads().values())
        return _N_BATCHES_PER_THREAD * max(1, threads)

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
        hint = "the same command goes on where this one ended"
        return SurveyError(refusal(self._where, "a cluster that responds", problem, hint))


def _refused_certificate(err: BaseException | None) -> str | None:
    """Return why a certificate was refused, if that caused the error."""
    while err is not None:
        if isinstance(err, ssl.SSLError):
            return err.verify_message if isinstance(err, ssl.SSLCertVerificationError) else str(err)
        err = err.__cause__ or err.__context__
    return None
