"""The explorer's server: the pages of a site and their panels, on the standard library's HTTP server.

It changes nothing and reads only its own files. It answers only requests whose Host header names this machine and whose
Origin, if present, is its own page, so that no other site can send requests on a visitor's behalf. A request also needs
the token, unless the user does without it on the loopback interface.

Each connection has a thread, and their number is bounded.
"""

import hmac
import ipaddress
import json
import re
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, unquote, urlsplit

from activefail.errors import InputError, StoreError
from activefail.pages.explorer.fields import Values
from activefail.pages.explorer.pages import page

if TYPE_CHECKING:
    from activefail.pages.explorer.pages import Site

LONGEST_BODY = 4096
"""Longest form [bytes]; one has a few hundred."""

MOST_CONNECTIONS = 512
"""Most open connections; each has a thread, and is closed when nothing comes for `_Handler.timeout`."""

_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every response."""

_FILES = {
    "/page.js": ("activefail.pages.explorer", "text/javascript; charset=utf-8"),
    "/explorer.css": ("activefail.pages.explorer", "text/css; charset=utf-8"),
    "/page.css": ("activefail.pages.report", "text/css; charset=utf-8"),
}
"""The pages' files, with their packages and types."""


def is_loopback(host: str) -> bool:
    """Whether an address is a loopback address, which other machines cannot reach."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return None


class ExplorerServer(ThreadingHTTPServer):
    """Serves the pages of a site and their panels.

    Attributes:
        token: required of visitors; empty if none is needed.
        site: pages and panels.

    Raises:
        InputError: if the address cannot be served.
    """

    daemon_threads = True
    # Connections waiting to be accepted; further visitors would wait for a retransmission.
    request_queue_size = 1024

    def __init__(self, host: str, port: int, site: "Site", needs_token: bool = False) -> None:
        self._host = host
        self.token = secrets.token_urlsafe(24) if needs_token or not is_loopback(host) else ""
        self.site = site
        self.room = threading.Semaphore(MOST_CONNECTIONS)
        bound = host.strip("[]")
        if ":" in bound:
            self.address_family = socket.AF_INET6
        try:
            super().__init__((bound, port), _Handler)
        except (OSError, TypeError) as error:  # TypeError: a name that cannot be encoded
            raise InputError(f"Cannot listen on {host}:{port}: {getattr(error, 'strerror', error)}.") from None

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Whether there is room for a connection; it is closed if not."""
        return self.room.acquire(blocking=False)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection until it is closed."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore disconnected visitors; print other errors."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)

    @property
    def cookie(self) -> str:
        """The name of the cookie that keeps the token: of this port, because all ports of a host share cookies."""
        return f"activefail-token-{self.server_address[1]}"

    @property
    def address(self) -> str:
        """The page's URL, including the token if one is required."""
        host = f"[{self._host}]" if ":" in self._host and not self._host.startswith("[") else self._host
        return f"http://{host}:{self.server_address[1]}/" + (f"?token={self.token}" if self.token else "")

    def knows(self, host: str) -> bool:
        """Whether a Host header names this server by its address or a name of this machine.

        An attacker can make any other name resolve to this machine. The port may be that of a tunnel.
        """
        name = re.sub(r":\d*$", "", host.lower())
        if is_loopback(self._host):
            return is_loopback(name) or bool(self.token)  # a proxy in front of it has other names
        return _address(name) is not None or name in {"localhost", self._host.lower(), socket.gethostname().lower()}


class _RefusedError(Exception):
    """A request that is not answered.

    Attributes:
        status: of the response.
    """

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: ExplorerServer
    protocol_version = "HTTP/1.1"
    timeout = 30  # [s] without a byte

    def do_GET(self) -> None:
        """Serve the pages and their files."""
        self._respond(self._serve_page_or_reason)

    def do_HEAD(self) -> None:
        """Like GET, without the body."""
        self.do_GET()

    def do_POST(self) -> None:
        """Make a panel of a page."""
        self._respond(self._answer)

    def _respond(self, respond: Callable[[], None]) -> None:
        """Respond to a visitor who may ask, or say why not."""
        try:
            self._check_visitor()
            respond()
        except _RefusedError as error:
            self._refuse(error.status, str(error))
        except (InputError, StoreError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
        except (ConnectionError, TimeoutError):
            raise
        except Exception:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, "The explorer failed; its terminal shows the error.")
            raise

    def _check_visitor(self) -> None:
        """Check path, body, Host, Origin and token.

        Raises:
            _RefusedError: if one of them is invalid.
        """
        lengths = self.headers.get_all("Content-Length", [])
        is_read = len(lengths) < 2 if self.command == "POST" else lengths in ([], ["0"])
        if "Transfer-Encoding" in self.headers or not is_read:
            # What is not read of a body would be the next request.
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "Only a form has a body, whose length it states once.")
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if not self.server.knows(host):
            raise _RefusedError(HTTPStatus.MISDIRECTED_REQUEST, "The Host header does not name this server.")
        # A proxy may replace the Host; browsers then still say whose page asks.
        is_own = self.headers.get("Sec-Fetch-Site") == "same-origin"
        if not is_own and origin not in (None, f"http://{host}", f"https://{host}"):
            text = "Requests from other sites are refused. A proxy over http must keep the Host header."
            raise _RefusedError(HTTPStatus.FORBIDDEN, text)
        try:
            self.url = urlsplit(self.path)
        except ValueError:
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "The path is invalid.") from None
        if self.server.token and not any(
            hmac.compare_digest(token.encode(), self.server.token.encode()) for token in self._tokens()
        ):
            raise _RefusedError(
                HTTPStatus.FORBIDDEN, "Open the address with the token that `activefail explore` printed."
            )

    def _tokens(self) -> list[str]:
        tokens = parse_qs(self.url.query).get("token", []) if self.command in ("GET", "HEAD") else []
        # Other programs of the host may have set cookies of any form.
        cookies = [part.strip().partition("=") for part in self.headers.get("Cookie", "").split(";")]
        return [*tokens, *(value for name, _, value in cookies if name == self.server.cookie)]

    def _serve_page_or_reason(self) -> None:
        try:
            self._serve_page()
        except (InputError, StoreError) as error:
            home = "../../" if self.url.path.startswith("/run/") else ""
            text = page("refused", title="activefail", reason=str(error), home=home)
            self._send(HTTPStatus.CONFLICT, "text/html; charset=utf-8", text.encode())

    def _place(self, path: str) -> "tuple[Site | None, str]":
        """The site of a path, None if there is none, and the path in it; that of a file alone opens no campaign."""
        of_campaign = re.fullmatch(r"/run/([^/]+)(/.*)", path)
        if of_campaign is None or of_campaign[2] in _FILES:
            return self.server.site, path if of_campaign is None else of_campaign[2]
        anew = self.command == "GET" and of_campaign[2] == "/"
        return self.server.site.below(unquote(of_campaign[1], errors="surrogateescape"), anew), of_campaign[2]

    def _serve_page(self) -> None:
        site, path = self._place(self.url.path)
        if path in _FILES:
            package, kind = _FILES[path]
            self._send(HTTPStatus.OK, kind, files(package).joinpath(path[1:]).read_bytes())
        elif site is None or (text := site.page(path)) is None:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "Page not found.")
        elif self.server.token and "token" in parse_qs(self.url.query):
            # Move the token to a cookie: addresses are copied and logged.
            # Relative, for a proxy that serves the pages below another path.
            cookie = f"{self.server.cookie}={self.server.token}; HttpOnly; SameSite=Lax; Path=/"
            headers = {"Location": f"./{path.rpartition('/')[2]}", "Set-Cookie": cookie}
            self._send(HTTPStatus.SEE_OTHER, "text/plain", b"", headers)
        else:
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", text.encode())

    def _answer(self) -> None:
        site, path = self._place(self.path)
        panel = site.panel(path.removeprefix("/api/")) if site and path.startswith("/api/") else None
        if panel is None:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "Unknown request.")
        self._send(HTTPStatus.OK, "text/html; charset=utf-8", panel(self._form()).encode())

    def _form(self) -> Values:
        """The form that a page sent, as JSON.

        Raises:
            _RefusedError: if there is none, or it is too long.
        """
        # Another site's page could send a form or plain text without a CORS preflight.
        if self.headers.get_content_type() != "application/json":
            raise _RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "A request must be application/json.")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit() and len(length) < 10 and int(length) <= LONGEST_BODY):
            text = f"A request must be at most {LONGEST_BODY} bytes."
            raise _RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, text)
        try:
            values = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            values = None
        if not isinstance(values, dict):
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "A request must be a JSON object.")
        return values

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send the base class's own errors, such as an unknown method, as JSON."""
        self._refuse(HTTPStatus(code), message or HTTPStatus(code).phrase)

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        # Unread data on the connection would be parsed as the next request.
        self.close_connection = True
        self._send(status, "application/json", json.dumps({"error": text}).encode(), {"Connection": "close"})

    def _send(self, status: HTTPStatus, kind: str, body: bytes, headers: Mapping[str, str] | None = None) -> None:
        self.send_response(status)
        of_body = {"Content-Type": kind, "Content-Length": str(len(body))}
        for name, value in (of_body | _HEADERS | dict(headers or {})).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def version_string(self) -> str:
        """Reveal only the server's name."""
        return "activefail"

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a log would contain the token."""
