"""The explorer's server answers only its own page on this machine."""

import http.client
import json
import re
import socket
import threading
from contextlib import ExitStack
from typing import Any

import pytest
from explorer.conftest import form, served, site_of
from patience import PATIENCE, until

from activefail.analyses.findings.results import Findings
from activefail.errors import InputError
from activefail.pages.explorer import server as explorer_server
from activefail.pages.explorer.server import LONGEST_BODY, ExplorerServer, is_loopback

POINT = [0.06, 2e9, 4.0, 0.5]
FORM = form(POINT, across="T_g", up="A_g", shown="failure", along="A_g")


class Reply:
    def __init__(self, response: http.client.HTTPResponse) -> None:
        self.status = response.status
        self.headers = response.headers
        self.text = response.read().decode()

    @property
    def json(self) -> Any:
        return json.loads(self.text)


def request(
    server: ExplorerServer, method: str = "GET", path: str = "/", body: bytes | None = None, **headers: str
) -> Reply:
    """A reply to a request with these headers (`Content_Type` for Content-Type); `Host` replaces the right one."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=PATIENCE)
    fields = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, path, skip_host="Host" in fields)
    for name, value in fields.items():
        connection.putheader(name, value)
    if body is not None and "Content-Length" not in fields:
        connection.putheader("Content-Length", str(len(body)))
    connection.endheaders(body)
    try:
        return Reply(connection.getresponse())
    finally:
        connection.close()


def ask(server: ExplorerServer, question: str, what: object, **headers: str) -> Reply:
    fields = {"Content_Type": "application/json"} | headers
    return request(server, "POST", f"/api/{question}", json.dumps(what).encode(), **fields)


@pytest.fixture(scope="module")
def abroad(findings: Findings):
    """A server that other machines may reach."""
    with served(site_of(findings), "0.0.0.0") as running:
        yield running


@pytest.fixture(scope="module")
def tokened(findings: Findings):
    """A server on this machine that needs the token."""
    with served(site_of(findings), "127.0.0.1", needs_token=True) as running:
        yield running


def test_the_page_its_files_and_its_questions_are_served(server):
    assert "This design" in request(server).text
    for path, kind in (("/page.js", "text/javascript"), ("/explorer.css", "text/css"), ("/page.css", "text/css")):
        answer = request(server, path=path)
        assert answer.status == 200
        assert answer.headers["Content-Type"].startswith(kind)
    shares = re.findall(r'data-probability="(.*?)"', ask(server, "predict", FORM).text)
    assert sum(map(float, shares)) == pytest.approx(1.0)
    assert ask(server, "plane", FORM).status == 200
    assert ask(server, "fragility", FORM).status == 200


def test_a_page_may_load_nothing_from_elsewhere_and_be_shown_nowhere_else(server):
    headers = request(server).headers
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Server"] == "activefail"
    assert "Access-Control-Allow-Origin" not in headers


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example", "127.0.0.1:{port}.evil.example", ""],
)
def test_another_host_s_name_is_not_answered(server, host):
    port = server.server_address[1]
    answer = request(server, Host=host.format(port=port))
    assert answer.status in (400, 421)
    assert "This design" not in answer.text


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1:{port}", "localhost:{port}", "LOCALHOST:{port}", "[::1]:{port}", "localhost:9000", "127.0.0.1:1"],
)
def test_this_machine_s_own_names_are_answered(server, host):
    assert request(server, Host=host.format(port=server.server_address[1])).status == 200


def test_another_site_s_page_may_not_ask(server):
    assert ask(server, "predict", FORM, Origin="http://evil.example").status == 403
    own = f"http://127.0.0.1:{server.server_address[1]}"
    assert ask(server, "predict", FORM, Origin=own).status == 200
    assert ask(server, "predict", FORM, Content_Type="text/plain").status == 415
    # Over http, browsers send no Sec-Fetch-Site to other names than localhost.
    answer = ask(server, "predict", FORM, Origin="http://hub.example")
    assert "must keep the Host header" in answer.text
    # A proxy replaced the Host; only a browser can say so.
    for site, status in (("same-origin", 200), ("same-site", 403), ("cross-site", 403)):
        asked = {"Origin": "https://hub.example", "Sec-Fetch-Site": site}
        assert ask(server, "predict", FORM, **asked).status == status


@pytest.mark.parametrize(
    ("question", "what", "status", "says"),
    [
        ("predict", FORM | {"A_g": 9.0}, 400, "A_g: must lie between 0.1 and 0.8, got 9.0"),
        ("predict", {"k": "2e9"}, 400, "mu: must lie between 0.02 and 0.12, got None"),
        ("predict", [1.0], 400, "must be a JSON object"),
        *(
            ("predict", FORM | {"A_g": value}, 400, "A_g: must lie between 0.1 and 0.8")
            for value in (float("nan"), 10**400, True, "nan", "much", "", [0.5], {})
        ),
        ("plane", FORM | {"up": "../../etc"}, 400, "up: must be one of mu"),
        ("plane", FORM | {"up": "T_g"}, 400, "two different variables"),
        ("plane", FORM | {"shown": ["failure"]}, 400, "shown: must be one of impact, failure, uncertainty"),
        ("delete", FORM, 404, "Unknown request"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused_in_words(server, question, what, status, says):
    answer = ask(server, question, what)
    assert answer.status == status
    assert says in answer.json["error"]
    assert "Traceback" not in answer.text


def test_what_is_no_json_or_too_long_or_of_no_length_is_refused(server):
    kind = {"Content_Type": "application/json"}
    assert request(server, "POST", "/api/predict", b"{", **kind).status == 400
    assert request(server, "POST", "/api/predict", b"[" * LONGEST_BODY, **kind).status == 400
    assert request(server, "POST", "/api/predict", b"x" * (LONGEST_BODY + 1), **kind).status == 413
    assert request(server, "POST", "/api/predict", None, **kind).status == 413
    assert request(server, "POST", "/api/predict", b"{}", Content_Length="-1", **kind).status == 413
    assert request(server, "POST", "/api/predict", b"{}", Content_Length="9" * 5000, **kind).status == 413
    assert request(server, path="/../pyproject.toml").status == 404
    here = f"127.0.0.1:{server.server_address[1]}"
    assert request(server, path="http://[", Host=here).json["error"] == "The path is invalid."
    answer = request(server, "PUT", "/")
    assert answer.status == 501
    assert answer.json["error"] == "Unsupported method ('PUT')"


@pytest.mark.parametrize(
    "head",
    [
        "GET / HTTP/1.1\r\nContent-Length: {length}",
        "HEAD / HTTP/1.1\r\nContent-Length: {length}",
        "GET / HTTP/1.1\r\nTransfer-Encoding: chunked",
        "GET / HTTP/1.1\r\nContent-Length: 0\r\nContent-Length: {length}",
        "POST /api/predict HTTP/1.1\r\nContent-Length: 0\r\nContent-Length: {length}",
        "POST /api/predict HTTP/1.1\r\nContent-Length: 0\r\nTransfer-Encoding: chunked",
    ],
)
def test_a_request_whose_body_is_not_read_is_refused_and_the_body_is_no_request(server, head: str) -> None:
    host = f"Host: 127.0.0.1:{server.server_address[1]}\r\n"
    body = f"GET /explorer.css HTTP/1.1\r\n{host}\r\n"
    with connected(server) as line:
        line.sendall(f"{head.format(length=len(body))}\r\n{host}Content-Type: application/json\r\n\r\n{body}".encode())
        received = line.makefile("rb").read()
    assert received.startswith(b"HTTP/1.1 400 ")
    assert received.count(b"HTTP/1.1 ") == 1


def test_a_request_that_says_that_it_has_no_body_is_answered(server) -> None:
    assert request(server, path="/explorer.css", Content_Length="0").status == 200


def test_what_is_no_http_is_refused_in_words(server):
    with socket.create_connection(("127.0.0.1", server.server_address[1]), timeout=PATIENCE) as line:
        line.sendall(b"nonsense\r\n\r\n")
        received = line.makefile("rb").read()
    assert b'{"error": "Bad request syntax' in received


def test_a_fault_of_the_explorer_is_told_in_its_terminal_and_not_to_the_page(findings, monkeypatch, capfd):
    def fails(values):
        raise RuntimeError("a secret of the machine")

    site = site_of(findings)
    monkeypatch.setattr(site, "panel", lambda name: fails)
    with served(site) as server:
        answer = ask(server, "predict", FORM)
    assert answer.status == 500
    assert answer.json == {"error": "The explorer failed; its terminal shows the error."}
    assert "a secret of the machine" in capfd.readouterr().err


def test_beyond_this_machine_a_token_is_needed_for_everything(abroad):
    assert abroad.address.endswith(f"/?token={abroad.token}")
    assert len(abroad.token) >= 32
    for answer in (
        request(abroad),
        request(abroad, path="/page.js"),
        request(abroad, path="/?token=wrong"),
        request(abroad, Cookie="activefail-token=wrong"),
        ask(abroad, "predict", FORM),
        request(abroad, "POST", f"/api/predict?token={abroad.token}", b"{}", Content_Type="application/json"),
    ):
        assert answer.status == 403
        assert abroad.token not in answer.text


def test_the_token_opens_the_page_and_goes_from_its_address_into_a_cookie(abroad):
    answer = request(abroad, path=f"/?token={abroad.token}")
    assert (answer.status, answer.headers["Location"]) == (303, "./")
    cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Lax" in cookie
    kept = cookie.split(";")[0]
    assert "This design" in request(abroad, Cookie=f'of another={{"a": 1}}; a:b=1; flag; {kept}').text
    assert "This design" in request(abroad, Cookie=kept).text
    assert ask(abroad, "predict", FORM, Cookie=kept).status == 200


def cookie_behind_a_proxy(server: ExplorerServer, path: str, design: dict[str, object] = FORM) -> str:
    """The cookie of a page behind a proxy, whose addresses are relative, and which gets answers."""
    answer = request(server, path=f"{path}?token={server.token}", Host="hub.example")
    assert (answer.status, answer.headers["Location"]) == (303, f".{path}")
    cookie = answer.headers["Set-Cookie"].split(";")[0]
    text = request(server, path=path, Host="hub.example", Cookie=cookie).text
    assert not re.findall(r"""(?:href|src)="/""", text)
    origin = {"Origin": "https://hub.example", "Host": "hub.example", "Cookie": cookie}
    assert ask(server, "predict", design, **origin).status == 200
    return cookie


def test_behind_a_proxy_that_adds_a_path_and_another_name_all_addresses_are_relative(tokened):
    cookie = cookie_behind_a_proxy(tokened, "/")
    text = request(tokened, path="/page.js", Cookie=cookie).text
    assert not re.findall(r"""(?:fetch\(|from )["'`]/""", text)
    assert request(tokened, Host="hub.example").status == 403


def test_abroad_a_name_that_may_be_anyone_s_is_not_answered_even_with_the_token(abroad):
    port = abroad.server_address[1]
    path = f"/?token={abroad.token}"
    assert request(abroad, path=path, Host=f"evil.example:{port}").status == 421
    assert request(abroad, path=path, Host=f"192.168.1.7:{port}").status == 303


def test_the_loopback_interface_is_told_apart():
    assert [host for host in ("127.0.0.1", "127.9.9.9", "localhost", "::1", "[::1]") if not is_loopback(host)] == []
    assert [host for host in ("0.0.0.0", "::", "192.168.0.1", "example.org", "") if is_loopback(host)] == []


def test_a_port_that_is_taken_is_named_with_the_reason(findings):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"Cannot listen on 127\.0\.0\.1:{port}: Address already in use"):
            ExplorerServer("127.0.0.1", port, site_of(findings))


# --- many visitors at once ---------------------------------------------------------------------------------------


def connected(server: ExplorerServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.server_address[1]), timeout=PATIENCE)


def question(server: ExplorerServer, path: str, what: object) -> bytes:
    """The bytes of a request."""
    body = json.dumps(what)
    head = f"POST /api/{path} HTTP/1.1\r\nHost: 127.0.0.1:{server.server_address[1]}\r\n"
    return f"{head}Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode()


def reply(line: socket.socket) -> Reply:
    """The whole response to what was sent; an error if it is cut short."""
    response = http.client.HTTPResponse(line)
    response.begin()
    return Reply(response)


def test_two_hundred_connections_that_come_at_once_all_get_a_whole_response(findings):
    with ExitStack() as stack:
        server = stack.enter_context(ExplorerServer("127.0.0.1", 0, site_of(findings)))
        # Nobody accepts them yet: the system must hold them all.
        lines = [stack.enter_context(connected(server)) for _ in range(200)]
        questions = [
            b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % server.server_address[1],
            question(server, "predict", FORM),
            question(server, "fragility", FORM),
            question(server, "plane", FORM),
        ]
        for number, line in enumerate(lines):
            kind = number % len(questions)
            # Only the first few ask for what takes long, a picture.
            line.sendall(questions[kind if number < 40 else min(kind, 1)])
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        replies = [reply(line) for line in lines]
        server.shutdown()
        thread.join()
    assert {answer.status for answer in replies} == {200}


def test_a_connection_beyond_the_most_is_closed_until_there_is_room(findings, monkeypatch):
    monkeypatch.setattr(explorer_server, "MOST_CONNECTIONS", 2)
    with served(site_of(findings)) as server:
        with connected(server) as one, connected(server) as other, connected(server) as beyond:
            assert beyond.recv(1) == b""
            for line in (one, other):
                line.sendall(question(server, "predict", FORM))
                assert reply(line).status == 200

        def is_served() -> bool:
            try:
                return request(server).status == 200
            except OSError:
                return False

        until(is_served, "room for a visitor")
