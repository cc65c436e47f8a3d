"""Workers of an existing dask cluster; needs the package ``distributed`` (extra ``cluster``).

A scheduler and its workers are trusted with everything: what they send is unpickled, which can run
any code here, and what is sent to them runs there. Who may be one of them is up to the certificates
of a ``tls://`` address; see docs/security.md.
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

from pfwd.archive.identity import software_version
from pfwd.archive.work import SourceOutcome, invert_batch
from pfwd.archive.workers import Batch
from pfwd.errors import OptionError, SurveyError, refusal

if TYPE_CHECKING:
    from pfwd.analysis.options import AnalysisOptions

_CONNECT_S = 20.0
_FIRST_WORKER_S = 60.0
"""s to wait for the first worker; a cluster may start them when they are asked for."""

_AHEAD = 2
"""Batches under way for each thread of the cluster: one is worked on, one lies ready."""


_ADDRESS = re.compile(
    r"(?:(?P<protocol>[a-z]+)://)?(?:\[(?P<six>[0-9a-fA-F:.%\w]+)\]|(?P<name>[^\s:/\[\]]+))"
    r":(?P<port>[0-9]{1,6})/?"
)

_PROTOCOLS = ("tcp", "tls", "ws", "wss", "ucx")
"""Protocols of dask between computers."""

_PROTECTED = ("tls", "wss", "inproc")
"""Protocols of dask that ask for certificates, or do not leave the program."""

_CERTIFICATES = "distributed.comm.tls: ca-file, client.cert and client.key (docs/security.md)"
"""Where dask reads which certificates to show and to believe."""


def unprotected(scheduler: str) -> str | None:
    """What to say of an address at which anybody on the way could give orders; None: nothing.

    Parameters
    ----------
    scheduler : str
        Address, as ``tcp://host:8786``.

    Examples
    --------
    >>> unprotected("tls://head-node:8786"), unprotected("tcp://127.0.0.1:8786")
    (None, None)
    """
    protocol, sign, rest = scheduler.rpartition("://")
    if sign and protocol in _PROTECTED:
        return None
    host = rest.rpartition(":")[0].strip("[]") or rest
    if _is_here(host):
        return None
    return (
        f"--scheduler {scheduler}: without certificates whoever reaches the cluster, or the way to "
        f"it, can run programs here and there; use tls://{rest} with dask's certificates "
        "(docs/security.md), or a network that you trust"
    )


def _is_here(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def check_address(scheduler: str) -> None:
    """Refuse at once what is no address of a scheduler, and a host that is not known.

    dask itself tries for most of a minute and prints a traceback at the end.

    Raises
    ------
    OptionError
    """
    where = f"--scheduler {scheduler}"
    if scheduler.startswith("inproc://"):  # of this program, by a script
        return
    parts = _ADDRESS.fullmatch(scheduler)
    known = parts is not None and parts["protocol"] in (None, *_PROTOCOLS)
    if parts is None or not known or not 0 < int(parts["port"]) <= 65_535:
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
    """A cluster that inverts batches; what a lost worker had is done again by another one.

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
        If ``distributed`` is not installed, the address is none, or it needs certificates that
        there are none of.
    SurveyError
        If there is no scheduler, no worker, or workers have another version of this program.
    """

    def __init__(self, options: AnalysisOptions, scheduler: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as err:
            hint = 'python -m pip install "pfwd[cluster]", or --jobs N without a cluster'
            raise OptionError(
                refusal("--scheduler", "the package distributed", "none", hint)
            ) from err
        check_address(scheduler)
        self._options = options
        self._where = f"--scheduler {scheduler}"
        security = distributed.Security()  # as dask is configured
        self._check_certificates(security, scheduler)
        try:
            self._client: Any = distributed.Client(
                scheduler, timeout=_CONNECT_S, set_as_default=False, security=security
            )
        except (ValueError, RuntimeError) as err:
            expected = "an address like tcp://host:8786"
            raise OptionError(refusal(self._where, expected, str(err))) from err
        except (OSError, TimeoutError) as err:
            refused = _refused_certificate(err)
            if refused is not None:
                expected, hint = "a scheduler whose certificate fits", f"see {_CERTIFICATES}"
                raise SurveyError(refusal(self._where, expected, refused, hint)) from err
            hint = "is it running, does it speak this protocol, and can it be reached from here?"
            raise SurveyError(refusal(self._where, "a scheduler", "no answer", hint)) from err
        try:
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """See :class:`~pfwd.archive.workers.Workers`.

        Raises
        ------
        SurveyError
            If the cluster is lost.
        """
        distributed: Any = import_module("distributed")
        waiting: list[Batch] = []
        under_way: dict[Any, Batch] = {}
        more = True
        try:
            while True:
                while waiting or (more and len(under_way) < self._most()):
                    batch = waiting.pop() if waiting else next(batches, None)
                    if batch is None:
                        more = False
                        continue
                    future = self._client.submit(
                        invert_batch, list(batch.sources), self._options, pure=False
                    )
                    under_way[future] = batch
                if not under_way:
                    return
                with self._client.as_current():
                    done = distributed.wait(list(under_way), return_when="FIRST_COMPLETED").done
                for future in done:
                    batch = under_way.pop(future)
                    if future.status == "finished":
                        outcomes: list[SourceOutcome] = future.result()
                        yield outcomes
                        continue
                    if future.status != "error":
                        raise self._lost(f"a task that is {future.status}")
                    error = future.exception()
                    if not isinstance(error, distributed.scheduler.KilledWorker):
                        raise self._lost(f"{type(error).__name__}: {error}")
                    again = batch.after_a_death()
                    waiting += again
                    if not again:
                        yield batch.given_up()
        except (OSError, TimeoutError, distributed.CancelledError) as err:
            raise self._lost(str(err) or type(err).__name__) from err

    def close(self) -> None:
        """Leave the cluster; what it still works on is forgotten there."""
        # A cluster that has gone cannot be left in good order.
        with contextlib.suppress(Exception):
            self._client.close(timeout=5.0)

    def _check_certificates(self, security: Any, scheduler: str) -> None:
        """Refuse a protected address without certificates, and a plain one where none may be."""
        if not scheduler.startswith(("tls://", "wss://")):
            if security.require_encryption and not scheduler.startswith("inproc://"):
                expected = "an address like tls://host:8786"
                hint = "dask is configured to require encryption"
                raise OptionError(refusal(self._where, expected, "a plain one", hint))
            return
        try:
            found = security.get_connection_args("client").get("ssl_context")
        except (OSError, ValueError) as err:  # errors of ssl are of the first kind
            came = str(err)
        else:
            if found is not None:
                return
            came = "none"
        raise OptionError(refusal(self._where, f"certificates in {_CERTIFICATES}", came))

    def _most(self) -> int:
        """Batches to have under way; asked anew, because clusters grow."""
        threads: int = sum(self._client.nthreads().values())
        return _AHEAD * max(1, threads)

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_S)
        except TimeoutError as err:
            came = f"none within {_FIRST_WORKER_S:.0f} s"
            raise SurveyError(refusal(self._where, "a worker", came)) from err
        hint = "install the same one everywhere"
        ours = software_version()
        try:
            versions = self._client.run(software_version)
        except Exception as err:
            expected = f"workers with pfwd {ours}"
            raise SurveyError(refusal(self._where, expected, str(err), hint)) from err
        for worker, version in versions.items():
            if version != ours:
                came = f"{version} on {worker}"
                raise SurveyError(refusal(self._where, f"pfwd {ours} on all", came, hint))

    def _lost(self, came: str) -> SurveyError:
        hint = "the same command goes on where this one ended"
        return SurveyError(refusal(self._where, "a cluster that answers", came, hint))


def _refused_certificate(err: BaseException | None) -> str | None:
    """Why certificates were refused, if that is behind an error."""
    while err is not None:
        if isinstance(err, ssl.SSLError):
            return err.verify_message if isinstance(err, ssl.SSLCertVerificationError) else str(err)
        err = err.__cause__ or err.__context__
    return None
