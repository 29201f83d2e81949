"""Who may talk to a page that is for this machine alone: the page itself, and programs that are no browser's.

A browser lets any page that it has open talk to a WebSocket of this machine; the Origin names the page. A name
of somebody else's that is made to lead here shows in the Host.
"""

import http
import ipaddress
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.exceptions import InvalidHandshake
from websockets.http11 import Request, Response


def is_local(host: str) -> bool:
    """Whether a name or address is this machine as only it can see itself."""
    if host.lower().rstrip(".") == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_own(headers: Headers) -> bool:
    """Whether a request to a local page names a local host, and comes from that very page or from no page at all."""
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        if not is_local(urlsplit(f"//{hosts[0]}").hostname or ""):
            return False
        return not origins or urlsplit(origins[0]).netloc.lower() == hosts[0].lower()
    except ValueError:  # Of an address that is none, such as an open bracket.
        return False


@contextmanager
def guarded(host: str) -> Iterator[None]:
    """While it lasts, servers that viser starts refuse requests of foreign pages, if `host` is local.

    A program that connects and does not speak as a page does is logged in one line at most. Viser has no option for
    the library beneath, so that library's function is exchanged for the moment.
    """
    original, only_here = server.serve, is_local(host)

    def serve(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def checked(connection: Any, request: Request) -> Any:
            if not only_here or is_own(request.headers):
                return process_request(connection, request)
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": "0"}), b"")

        return original(*arguments, process_request=checked, logger=_CONNECTIONS, **options)

    server.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        server.serve = original  # pyright: ignore[reportAttributeAccessIssue]


def _in_one_line(record: logging.LogRecord) -> bool:
    """Log no line of connections without a request, as scans of ports make them; one line of others that fail."""
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, InvalidHandshake | ConnectionError | EOFError):
        return False
    if error is not None:
        record.msg, record.args = "view: a connection was closed after an error (%s: %s)", (type(error).__name__, error)
        record.exc_info = record.exc_text = None
    return True


_CONNECTIONS = logging.getLogger(__name__)
_CONNECTIONS.addFilter(_in_one_line)
