"""Attacks on a running service: each must be refused with a reason, and the service survives."""

import base64
import http.client
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import httpx

from palpate.service.server.jobs.home_and_tokens import Tokens
from tests.robustness.outcome import SECRET
from tests.service.server.service_process import TOKEN, ServiceProcess, running_service

API = "/api/v1"
SIGNED = {"Authorization": f"Bearer {TOKEN}"}
HEALTH_S = 2.0
UP = (
    "..", "%2e%2e", "%2E%2E%2F", "..%2f", "..%5c", "....//", "%252e%252e", "..;", "%00",
    ".service", "%c0%ae%c0%ae", "a%00b", "~", "*", "-rf", "a" * 300, "%ff", "\\\\host",
    "x%0d%0aSet-Cookie:",
)  # fmt: skip
PATHS = ("/jobs/{}/journal", "/jobs/{}/files/x.txt", "/uploads/{}/a.csv")
NRRD = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n{}\n\n"
UPLOADS: dict[str, tuple[str, bytes]] = {
    "NRRD data file": ("a.nrrd", NRRD.format("data file: /etc/passwd").encode()),
    "NRRD datafile": ("a.nrrd", NRRD.format("datafile: ../../secret.txt").encode()),
    "NRRD leading blank": ("a.nrrd", NRRD.format(" data file: /etc/passwd").encode()),
    "NRRD non-ASCII key": ("a.nrrd", NRRD.format("da\u00fcta file: /etc/passwd").encode("latin1")),
    "NRRD large header": (
        "a.nrrd", NRRD.format("#x\n" * 300_000 + "data file: /etc/passwd").encode(),
    ),
    "detached header": ("a.nhdr", NRRD.format("data file: /etc/passwd").encode()),
    "OME-TIFF": ("a.tif", b'II*\0<UUID FileName="/etc/passwd">'),
    "binary path": (
        "case.yaml", b"scans: {reference: !!binary %s}" % base64.b64encode(b"/etc/passwd"),
    ),
    "set path": ("case.yaml", b"scans: {reference: !!set {/etc/passwd}}"),
    "absolute path": ("case.yaml", b"scans: {reference: /etc/passwd}"),
    "path upwards": ("case.json", b'{"scans": {"reference": "../../secret.txt"}}'),
    "python object": ("case.yaml", b"a: !!python/object/apply:os.system [id]"),
    "brackets": ("case.yaml", b"[" * 100_000),
    "digits": ("case.yaml", b"a: " + b"9" * 5000),
    "not UTF-8": ("case.yaml", b"\xff\xfe\0"),
    "a program": ("tool.py", b"print()"),
    "an archive": ("a.tar", b""),
    "no suffix": ("a", b""),
}  # fmt: skip
BODIES: tuple[bytes, ...] = (
    b"", b"{", b"\xff", b"null", b"[]", b'{"study": NaN}', b'{"study": {}}', b"[" * 60_000,
    b'{"study": 1, "study": 2}', b'{"study": "' + b"x" * 200_000 + b'"}', b'{"study": ""}',
    b'{"study": "a: &a [*a]"}', b'{"study": "name: !!binary L2V0Yw=="}', b'{"priority": 1e999}',
    b'{"study": "x", "priority": 99999999999999999999999}', b'{"study": {"name": {"a": {}}}}',
    b'{"source": {"upload": "../x"}}', b'{"source": {"study": "x", "upload": "y"}}',
)  # fmt: skip
RAW: tuple[bytes, ...] = (
    b"GET / HTTP/9.9\r\n\r\n", b"\x16\x03\x01\x02\0\x01", b"GET  / HTTP/1.1\r\nHost:\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 200_000 + b"\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n",
    b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n",
    b"PUT / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n", b"\0" * 1000, b"GET\r\n" * 100,
    b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", b"OPTIONS * HTTP/1.1\r\nHost: x\r\n\r\n",
)  # fmt: skip

Check = Callable[[ServiceProcess], str]


def attacks() -> Iterator[tuple[str, Check]]:
    """Yield names and checks; a check returns the reason of a failure, or an empty text."""
    for method in ("GET", "PUT", "DELETE"):
        for path in PATHS:
            for up in UP:
                yield f"{method} {path.format(up)[:60]}", _refused(method, path.format(up), b"1")
    for name, (file, content) in UPLOADS.items():
        path = f"/uploads/bad/{quote(file)}"
        yield f"upload: {name}", _refused("PUT", path, content)
    for path in ("/studies", "/diagnoses"):
        for number, body in enumerate(BODIES):
            yield f"{path}: body {number}", _refused("POST", path, body)
    for number, content in enumerate(RAW):
        yield f"raw bytes {number}", _raw(content)
    for host in ("evil.example", "127.0.0.1.evil.example", "", "[", "localhost.evil.example:80"):
        yield f"host {host!r}", _refused("GET", "/health", b"", {"Host": host})
    for header in ({"Origin": "https://evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
        yield f"forged {header}", _refused("POST", "/studies", b"{}", header)
    for token in ("", "wrong", TOKEN[:-1], TOKEN * 2, "\u00fc"):
        given = {"Authorization": f"Bearer {token}".encode().decode("latin1")}
        yield f"token {token[:20]!r}", _refused("POST", "/studies", b"{}", given)
    yield "a token that reads only", _reads_only
    yield "20 uploads at once against the limit", _many_uploads
    yield "530 half-open connections", _half_open


def _request(
    service: ServiceProcess, method: str, path: str, body: bytes, headers: dict[str, str]
) -> tuple[int, bytes]:
    where = urlsplit(service.url)
    connection = http.client.HTTPConnection(str(where.hostname), where.port, timeout=30)
    try:
        connection.putrequest(method, API + path, skip_host="Host" in headers)
        for name, value in (SIGNED | {"Content-Length": str(len(body))} | headers).items():
            connection.putheader(name, value)
        connection.endheaders(body or None)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def _refused(method: str, path: str, body: bytes, headers: dict[str, str] | None = None) -> Check:
    def check(service: ServiceProcess) -> str:
        try:
            status, answer = _request(service, method, path, body, headers or {})
        except (http.client.InvalidURL, ValueError):
            return ""  # the client of the attack refuses
        except (ConnectionError, http.client.HTTPException):
            return ""  # it was cut off
        if not 400 <= status < 500:
            return f"status {status}: {answer[:200]!r}"
        return _leak(service, answer)

    return check


def _leak(service: ServiceProcess, answer: bytes) -> str:
    text = answer.decode(errors="replace")
    for what in (SECRET, "Traceback", str(service.home), "root:x:0", "site-packages"):
        if what in text:
            return f"the answer shows {what}: {text[:300]}"
    return ""


def _raw(content: bytes) -> Check:
    def check(service: ServiceProcess) -> str:
        where = urlsplit(service.url)
        with socket.create_connection((str(where.hostname), int(where.port or 0))) as one:
            one.settimeout(20)
            try:
                one.sendall(content)
                one.shutdown(socket.SHUT_WR)
                answer = one.recv(2**16)
            except OSError:
                return ""
        good = not answer or answer.split(b" ")[1][:1] == b"4"
        return _leak(service, answer) if good else f"answered {answer[:100]!r}"

    return check


def _reads_only(service: ServiceProcess) -> str:
    token = Tokens(service.home / ".service" / "tokens.json", "").new("reader", "read")
    given = {"Authorization": f"Bearer {token}"}
    for method, path in (
        ("POST", "/studies"),
        ("PUT", "/uploads/f/a.csv"),
        ("DELETE", "/uploads/f"),
    ):
        status, _ = _request(service, method, path, b"{}", given)
        if status != 403:
            return f"{method} {path}: {status}"
    return ""


def _many_uploads(service: ServiceProcess) -> str:
    def content() -> Iterator[bytes]:
        for _ in range(64):
            yield b"1" * 2**13

    from concurrent.futures import ThreadPoolExecutor

    def put(number: int) -> int:
        url = f"{service.url}{API}/uploads/many/{number}.csv"
        return httpx.put(url, content=content(), headers=SIGNED, timeout=60).status_code

    with ThreadPoolExecutor(20) as pool:
        codes = list(pool.map(put, range(20)))
    held = sum(p.stat().st_size for p in (service.home / ".service" / "uploads").rglob("*.csv"))
    if held > 4 * 2**20 or not set(codes) <= {201, 413} or 413 not in codes:
        return f"{held} bytes are held; {codes}"
    httpx.delete(f"{service.url}{API}/uploads/many", headers=SIGNED)
    return ""


def _half_open(service: ServiceProcess) -> str:
    where = urlsplit(service.url)
    with ExitStack() as stack:
        for _ in range(530):
            address = (str(where.hostname), int(where.port or 0))
            one = stack.enter_context(socket.create_connection(address))
            one.sendall(b"GET / HTTP/1.1\r\nHost:")
        return _healthy(service)


def _healthy(service: ServiceProcess) -> str:
    """Return a failure of /health; a slow answer counts only if the next one is slow, too."""
    took = 0.0
    for _ in range(3):
        began = time.monotonic()
        try:
            httpx.get(f"{service.url}{API}/health", timeout=20).raise_for_status()
        except httpx.HTTPError as error:
            return f"/health: {error!r}"
        took = time.monotonic() - began
        if took <= HEALTH_S:
            return ""
    return f"/health took {took:.1f} s"


def run(folder: Path, log: Callable[[str], object]) -> dict[str, str]:
    """Run all attacks on one service and return the failures."""
    found: dict[str, str] = {}
    folder.mkdir(parents=True)
    (folder / "secret.txt").write_text(SECRET)
    with running_service(folder / "runs", ["--workers", "1"]) as service:
        for name, check in attacks():
            found[name] = check(service) or _healthy(service)
            if found[name]:
                log(f"{name}: {found[name]}")
    return found


def jobs_of(service: ServiceProcess) -> Any:
    """Return the jobs listed by a service."""
    return json.loads(httpx.get(f"{service.url}{API}/jobs", headers=SIGNED).content)["jobs"]
