"""The explorer's server: two pages and the requests that they make, on the standard library's HTTP server.

It changes nothing and reads only its own files. It answers only requests whose Host header names this machine and whose
Origin, if present, is its own page, so that no other site can send requests on a visitor's behalf. Beyond the loopback
interface a request also needs the token. At most one verification runs in the background.

Each connection has a thread, and their number is bounded. Browsers keep idle connections open, so at the limit the
server closes the one that has been idle longest. The number of questions in progress is bounded too: any further
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
from activefail.explorer.design import DesignAnswers
from activefail.explorer.verification import AlreadyRunningError, Verifications

LONGEST_BODY = 4096
"""Longest question [bytes]; a design has about a hundred."""

MOST_CONNECTIONS = 512
"""Most open connections; each has a thread."""

MOST_QUESTIONS = 32
"""Most questions in progress. A browser opens at most six connections to a server."""

_LENGTH = re.compile(r"[0-9]{1,9}")

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_COOKIE = "activefail-token"


def is_loopback(host: str) -> bool:
    """Whether an address is a loopback address, which other machines cannot reach."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def page(about: Answer, failure: dict[str, Any] | None = None) -> str:
    """Render the page of a campaign.

    Args:
        about: the data that the page contains from the start.
        failure: numbers and pictures of the probability of failure; None without one.
    """
    return _rendered("explorer.html.j2", about=about, failure=failure)


def design_page(about: Answer) -> str:
    """Render the page Design of a campaign from the data that it contains from the start."""
    return _rendered("design.html.j2", about=about)


def _rendered(template: str, **values: Any) -> str:
    environment = Environment(
        loader=PackageLoader("activefail.explorer", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(version=__version__, **values)


class ExplorerServer(ThreadingHTTPServer):
    """Serves the pages of a campaign and answers their questions.

    Attributes:
        token: required of visitors; empty on the loopback interface.
        turns: limits the questions in progress.
        pages, files: responses to GET by path: the pages, and their scripts and style.
        questions: handlers of POST, by path.
        verifications: in the background.

    Raises:
        InputError: if the address cannot be served.
    """

    daemon_threads = True
    # Connections waiting to be accepted; further visitors would wait for a retransmission.
    request_queue_size = 1024

    def __init__(self, host: str, port: int, answers: Answers) -> None:
        self._host = host
        # Ordered by last activity, the oldest first.
        self.connections: dict[socket.socket, None] = {}
        self._fewer = threading.Condition()
        self.turns = threading.BoundedSemaphore(MOST_QUESTIONS)
        self.token = "" if is_loopback(host) else secrets.token_urlsafe(24)
        design = DesignAnswers(answers)
        self.pages = {
            "/": page(answers.about(), answers.failure).encode(),
            "/design": design_page(design.about()).encode(),
        }
        package = files("activefail.explorer")
        kinds = {"js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8"}
        self.files = {
            f"/{name}": (kinds[name.rpartition(".")[2]], package.joinpath(name).read_bytes())
            for name in ("common.js", "explorer.js", "design.js", "explorer.css")
        }
        self.verifications = Verifications()
        self.questions: dict[str, Callable[[dict[str, Any]], Answer]] = {
            "/api/predict": lambda question: answers.predict(answers.point(question.get("point"))),
            "/api/plane": lambda question: answers.plane(
                answers.point(question.get("point")),
                answers.variable(question.get("x")),
                answers.variable(question.get("y")),
                str(question.get("shown")),
            ),
            "/api/fragility": lambda question: answers.fragility(
                answers.point(question.get("point")), answers.variable(question.get("along"))
            ),
            "/api/simulate": lambda question: answers.simulate(answers.point(question.get("point"))),
            "/api/histories": lambda question: answers.histories(
                answers.point(question.get("point")), question.get("narrow") is True
            ),
            "/api/design": lambda question: design.required(
                design.asked(question, ("refined",)), question.get("refined") is True
            ),
            "/api/verify": lambda question: self._verify(design, question),
            "/api/progress": lambda question: self.verifications.of(question.get("id")).progress(),
            "/api/stop": lambda question: self._stop(question),
        }
        bound = host.strip("[]")
        if ":" in bound:
            self.address_family = socket.AF_INET6
        try:
            super().__init__((bound, port), _Handler)
        except OSError as error:
            raise InputError(f"Cannot listen on {host}:{port}: {error.strerror or error}.") from None
        except TypeError as error:
            # `bind` raises this for a name that it cannot encode.
            raise InputError(f"--host: {host!r} is not an address: {error}.") from None
        except OverflowError:
            raise InputError(f"--port: must lie between 0 and 65535, got {port}.") from None

    def _verify(self, design: DesignAnswers, question: dict[str, Any]) -> Answer:
        """Start a verification.

        Raises:
            InputError: if the question is invalid, or the explorer does not verify this campaign.
            AlreadyRunningError: if another verification is running.
        """
        asked = design.asked(question)
        if reason := design.no_verification():
            raise InputError(reason)
        return self.verifications.start(lambda watch: design.verified(asked, watch))

    def _stop(self, question: dict[str, Any]) -> Answer:
        """Ask a verification to stop; its progress."""
        verification = self.verifications.of(question.get("id"))
        verification.stop()
        return verification.progress()

    def server_close(self) -> None:
        """Stop listening, and stop the verification."""
        super().server_close()
        self.verifications.stop()

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept the next connection.

        Raises:
            OSError: if there is no room for it yet; `serve_forever` tries again.
        """
        if len(self.connections) >= MOST_CONNECTIONS:
            self._make_room()
        try:
            accepted = super().get_request()
        except OSError:
            # The process may have run out of file descriptors.
            self._make_room()
            raise
        self.heard_from(accepted[0])
        return accepted

    def _make_room(self) -> None:
        """Close the connection that has been idle longest; a question in progress on it is still answered.

        Raises:
            BlockingIOError: if no connection ended within half a second.
        """
        with self._fewer:
            idle = next(iter(self.connections), None)
            if idle is not None:
                # If this connection is slow to close, the next attempt takes another one.
                self.heard_from(idle)
                # Its thread reads the end of the stream but can still write.
                with suppress(OSError):
                    idle.shutdown(socket.SHUT_RD)
            if not self._fewer.wait(0.5):
                raise BlockingIOError("The explorer accepts no further connection yet.")

    def heard_from(self, connection: socket.socket) -> None:
        """Mark a connection as the most recently active."""
        with self._fewer:
            self.connections.pop(connection, None)
            self.connections[connection] = None

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        super().shutdown_request(request)
        with self._fewer:
            self.connections.pop(request, None)
            self._fewer.notify()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore disconnected visitors; print other errors."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """The page's URL, including the token if one is required."""
        host = f"[{self._host}]" if ":" in self._host and not self._host.startswith("[") else self._host
        return f"http://{host}:{self.server_address[1]}/" + (f"?token={self.token}" if self.token else "")

    def knows(self, host: str | None) -> bool:
        """Whether a Host header names this server by its address or a name of this machine.

        An attacker can make any other name resolve to this machine.
        """
        try:
            parts = urlsplit(f"//{host}")
            port = parts.port or 80
        except ValueError:
            return False
        name = parts.hostname
        if not host or name is None or parts.path or port != self.server_address[1]:
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
        """Read and answer one request of the connection."""
        super().handle_one_request()
        self.server.heard_from(self.connection)

    def do_GET(self) -> None:
        """Serve the pages and their files."""
        if not self._may_ask():
            return
        url = urlsplit(self.path)
        if url.path in self.server.pages:
            if self.server.token and "token" in parse_qs(url.query):
                # Move the token to a cookie: addresses are copied and logged.
                cookie = f"{_COOKIE}={self.server.token}; HttpOnly; SameSite=Strict; Path=/"
                self._send(HTTPStatus.SEE_OTHER, "text/plain", b"", {"Location": url.path, "Set-Cookie": cookie})
            else:
                self._send(HTTPStatus.OK, "text/html; charset=utf-8", self.server.pages[url.path])
        elif url.path in self.server.files:
            self._send(HTTPStatus.OK, *self.server.files[url.path])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "Page not found.")

    def do_HEAD(self) -> None:
        """Like GET, without the body."""
        self.do_GET()

    def do_POST(self) -> None:
        """Answer a question of the page, as JSON."""
        if not self._may_ask():
            return
        handler = self.server.questions.get(self.path)
        if handler is None:
            self._refuse(HTTPStatus.NOT_FOUND, "Unknown request.")
            return
        # Another site's page could send a form or plain text without a CORS preflight.
        if self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "A request must be application/json.")
            return
        length = self.headers.get("Content-Length", "")
        if not _LENGTH.fullmatch(length) or int(length) > LONGEST_BODY:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"A request must be at most {LONGEST_BODY} bytes.")
            return
        try:
            question = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            question = None
        if not isinstance(question, dict):
            self._refuse(HTTPStatus.BAD_REQUEST, "A request must be a JSON object.")
            return
        if not self.server.turns.acquire(blocking=False):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "The explorer is busy; try again.", {"Retry-After": "1"})
            return
        try:
            answer = handler(question)
        except AlreadyRunningError as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
            return
        except InputError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
            return
        except Exception:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, "The explorer failed; its terminal shows the error.")
            raise
        finally:
            self.server.turns.release()
        self._send(HTTPStatus.OK, "application/json", json.dumps(answer, allow_nan=False).encode())

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send the base class's own errors, such as an unknown method, as JSON."""
        self._refuse(HTTPStatus(code), message or HTTPStatus(code).phrase)

    def _may_ask(self) -> bool:
        """Whether path, Host, Origin and token are valid; refuses the request if not."""
        try:
            urlsplit(self.path)
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST, "The path is invalid.")
            return False
        if not self.server.knows(self.headers.get("Host")):
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST, "The Host header does not name this server.")
            return False
        origin = self.headers.get("Origin")
        if origin is not None and origin != f"http://{self.headers.get('Host')}":
            self._refuse(HTTPStatus.FORBIDDEN, "Requests from other sites are refused.")
            return False
        if self.server.token and not any(
            hmac.compare_digest(token.encode(), self.server.token.encode()) for token in self._tokens()
        ):
            self._refuse(HTTPStatus.FORBIDDEN, "Open the address with the token that `activefail explore` printed.")
            return False
        return True

    def _tokens(self) -> list[str]:
        tokens = parse_qs(urlsplit(self.path).query).get("token", []) if self.command in ("GET", "HEAD") else []
        try:
            cookie = SimpleCookie(self.headers.get("Cookie", "")).get(_COOKIE)
        except CookieError:
            cookie = None
        return [*tokens, *([cookie.value] if cookie else [])]

    def _refuse(self, status: HTTPStatus, text: str, headers: dict[str, str] | None = None) -> None:
        # Unread data on the connection would be parsed as the next request.
        self.close_connection = True
        body = json.dumps({"error": text}).encode()
        self._send(status, "application/json", body, {"Connection": "close"} | (headers or {}))

    def _send(self, status: HTTPStatus, kind: str, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        defaults = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        for name, value in (defaults | (headers or {})).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def version_string(self) -> str:
        """Reveal only the server's name."""
        return "activefail"

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a log would contain the token."""
