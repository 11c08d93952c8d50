"""The explorer's server: one page and the questions that it asks, on the standard library's HTTP server.

It changes nothing and reads no file but its own. It answers only requests whose Host header names this machine and
whose Origin, if there is one, is its own page, so that no other site can ask in a visitor's name. Beyond the loopback
interface a request needs the token, too.

Each connection has a thread, and their number is bounded. Browsers keep idle connections open, so at the limit the
server closes the one that has been idle longest. The number of questions in progress is bounded, too: any further
question is answered with 503 and Retry-After.
"""

import hmac
import ipaddress
import json
import re
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

from jinja2 import Environment, PackageLoader, StrictUndefined

from activefail import __version__
from activefail.errors import InputError
from activefail.explorer.answers import Answer, Answers

LONGEST_BODY = 4096
"""Of a question [bytes]; a design is some hundred."""

MOST_CONNECTIONS = 512
"""Open at once; each has a thread."""

MOST_QUESTIONS = 32
"""In progress at once. A browser opens at most six connections to a server."""

_LENGTH = re.compile(r"[0-9]{1,9}")

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_COOKIE = "activefail-token"


def is_loopback(host: str) -> bool:
    """Whether an address is this machine's own, which no other machine reaches."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def page(about: Answer) -> str:
    """The page of a campaign."""
    environment = Environment(
        loader=PackageLoader("activefail.explorer", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("explorer.html.j2").render(about=about, version=__version__)


class ExplorerServer(ThreadingHTTPServer):
    """Serves the page of a campaign and answers its questions.

    Attributes:
        token: that a visitor must have; empty on the loopback interface.
        turns: questions that may be in progress.
        page, files: what GET answers: the page, and its script and style by path.
        questions: what POST answers, by path.

    Raises:
        InputError: if nothing can be served at this address.
    """

    daemon_threads = True
    # Connections that the system keeps until we accept them; further visitors would wait for a retransmission.
    request_queue_size = 1024

    def __init__(self, host: str, port: int, answers: Answers) -> None:
        self._host = host
        # The one that has been idle longest first.
        self._connections: dict[socket.socket, None] = {}
        self._fewer = threading.Condition()
        self.turns = threading.BoundedSemaphore(MOST_QUESTIONS)
        self.token = "" if is_loopback(host) else secrets.token_urlsafe(24)
        self.page = page(answers.about()).encode()
        read = files("activefail.explorer")
        self.files = {
            "/explorer.js": ("text/javascript; charset=utf-8", read.joinpath("explorer.js").read_bytes()),
            "/explorer.css": ("text/css; charset=utf-8", read.joinpath("explorer.css").read_bytes()),
        }
        self.questions: dict[str, Callable[[dict[str, Any]], Answer]] = {
            "/api/predict": lambda asked: answers.predict(answers.point(asked.get("point"))),
            "/api/plane": lambda asked: answers.plane(
                answers.point(asked.get("point")),
                answers.variable(asked.get("x")),
                answers.variable(asked.get("y")),
                str(asked.get("shown")),
            ),
            "/api/fragility": lambda asked: answers.fragility(
                answers.point(asked.get("point")), answers.variable(asked.get("along"))
            ),
            "/api/simulate": lambda asked: answers.simulate(answers.point(asked.get("point"))),
            "/api/histories": lambda asked: answers.histories(
                answers.point(asked.get("point")), asked.get("narrow") is True
            ),
        }
        bound = host.strip("[]")
        if ":" in bound:
            self.address_family = socket.AF_INET6
        try:
            super().__init__((bound, port), _Handler)
        except OSError as error:
            raise InputError(f"{host}:{port}: cannot be served: {error.strerror or error}.") from None
        except TypeError as error:
            # What `bind` raises of a name that it cannot encode.
            raise InputError(f"--host: {host!r} is no address: {error}.") from None
        except OverflowError:
            raise InputError(f"--port: must lie between 0 and 65535, got {port}.") from None

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept the next connection.

        Raises:
            OSError: if there is no room for it yet; `serve_forever` tries again.
        """
        if len(self._connections) >= MOST_CONNECTIONS:
            self._make_room()
        try:
            accepted = super().get_request()
        except OSError:
            # Perhaps the process has used up its descriptors.
            self._make_room()
            raise
        self.heard_from(accepted[0])
        return accepted

    def _make_room(self) -> None:
        """End the connection that has been idle longest; a question in progress on it is still answered.

        Raises:
            BlockingIOError: if no connection ended within half a second.
        """
        with self._fewer:
            idle = next(iter(self._connections), None)
            if idle is not None:
                # The next attempt takes another one, in case this one is slow to end.
                self.heard_from(idle)
                # Its thread reads the end of the stream; what it writes still reaches the visitor.
                with suppress(OSError):
                    idle.shutdown(socket.SHUT_RD)
            if not self._fewer.wait(0.5):
                raise BlockingIOError("There is no room for another connection yet.")

    def heard_from(self, connection: socket.socket) -> None:
        """Note that a connection is new or was just answered; all others have been idle for longer."""
        with self._fewer:
            self._connections.pop(connection, None)
            self._connections[connection] = None

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        super().shutdown_request(request)
        with self._fewer:
            self._connections.pop(request, None)
            self._fewer.notify()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A visitor who goes away in the middle is no fault; anything else is printed."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """Where the page is, with the token where one is needed."""
        host = f"[{self._host}]" if ":" in self._host and not self._host.startswith("[") else self._host
        return f"http://{host}:{self.server_address[1]}/" + (f"?token={self.token}" if self.token else "")

    def knows(self, host: str | None) -> bool:
        """Whether a Host header names this server by its address or a name of this machine.

        Any other name may be someone else's who had it resolve to this machine.
        """
        try:
            named = urlsplit(f"//{host}")
            port = named.port or 80
        except ValueError:
            return False
        name = named.hostname
        if not host or name is None or named.path or port != self.server_address[1]:
            return False
        if is_loopback(self._host):
            return is_loopback(name)
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in {"localhost", self._host.lower(), socket.gethostname().lower()}
        return True


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: ExplorerServer
    protocol_version = "HTTP/1.1"
    timeout = 30  # [s] without a byte

    def handle_one_request(self) -> None:
        """Read one request of the connection and answer it."""
        super().handle_one_request()
        self.server.heard_from(self.connection)

    def do_GET(self) -> None:
        """The page and its two files."""
        if not self._may_ask():
            return
        asked = urlsplit(self.path)
        if asked.path == "/":
            if self.server.token and "token" in parse_qs(asked.query):
                # The token goes into a cookie, out of the address that is copied and logged.
                cookie = f"{_COOKIE}={self.server.token}; HttpOnly; SameSite=Strict; Path=/"
                self._send(HTTPStatus.SEE_OTHER, "text/plain", b"", {"Location": "/", "Set-Cookie": cookie})
            else:
                self._send(HTTPStatus.OK, "text/html; charset=utf-8", self.server.page)
        elif asked.path in self.server.files:
            self._send(HTTPStatus.OK, *self.server.files[asked.path])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "There is nothing here.")

    def do_HEAD(self) -> None:
        """As GET, without the body."""
        self.do_GET()

    def do_POST(self) -> None:
        """A question of the page, as JSON."""
        if not self._may_ask():
            return
        answer = self.server.questions.get(self.path)
        if answer is None:
            self._refuse(HTTPStatus.NOT_FOUND, "There is no such question.")
            return
        # A form or a plain text is what another site's page could send without asking.
        if self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "A question must be application/json.")
            return
        length = self.headers.get("Content-Length", "")
        if not _LENGTH.fullmatch(length) or int(length) > LONGEST_BODY:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"A question is at most {LONGEST_BODY} bytes.")
            return
        try:
            asked = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict):
            self._refuse(HTTPStatus.BAD_REQUEST, "A question must be a JSON object.")
            return
        if not self.server.turns.acquire(blocking=False):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "The explorer is busy; ask again.", {"Retry-After": "1"})
            return
        try:
            said = answer(asked)
        except InputError as wrong:
            self._refuse(HTTPStatus.BAD_REQUEST, str(wrong))
            return
        except Exception:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, "The explorer failed; its terminal says how.")
            raise
        finally:
            self.server.turns.release()
        self._send(HTTPStatus.OK, "application/json", json.dumps(said, allow_nan=False).encode())

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the base class refuses by itself, a method or a request line that it does not know, as JSON too."""
        self._refuse(HTTPStatus(code), message or HTTPStatus(code).phrase)

    def _may_ask(self) -> bool:
        """Whether address, Host, Origin and token are right; answers the request if not."""
        try:
            urlsplit(self.path)
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST, "The address is none.")
            return False
        if not self.server.knows(self.headers.get("Host")):
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST, "The Host header does not name this server.")
            return False
        origin = self.headers.get("Origin")
        if origin is not None and origin != f"http://{self.headers.get('Host')}":
            self._refuse(HTTPStatus.FORBIDDEN, "Another site's page may not ask.")
            return False
        if self.server.token and not any(
            hmac.compare_digest(given.encode(), self.server.token.encode()) for given in self._tokens()
        ):
            self._refuse(HTTPStatus.FORBIDDEN, "Open the address with its token, which `activefail explore` printed.")
            return False
        return True

    def _tokens(self) -> list[str]:
        given = parse_qs(urlsplit(self.path).query).get("token", []) if self.command in ("GET", "HEAD") else []
        try:
            cookie = SimpleCookie(self.headers.get("Cookie", "")).get(_COOKIE)
        except CookieError:
            cookie = None
        return [*given, *([cookie.value] if cookie else [])]

    def _refuse(self, status: HTTPStatus, text: str, more: dict[str, str] | None = None) -> None:
        # What was sent and not read would be taken for the next request.
        self.close_connection = True
        body = json.dumps({"error": text}).encode()
        self._send(status, "application/json", body, {"Connection": "close"} | (more or {}))

    def _send(self, status: HTTPStatus, kind: str, body: bytes, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        for name, value in (headers | (more or {})).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def version_string(self) -> str:
        """Says no more of the server than its name."""
        return "activefail"

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: a log would hold the token."""
