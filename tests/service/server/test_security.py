"""Hostile input is rejected: paths, bombs, floods and forged requests."""

import http.client
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
import yaml

from palpate.service.remote_client import Client
from palpate.service.server.jobs.untrusted_inputs import parsed_text, refuse_paths
from palpate.storage.errors import InputError
from palpate.workers.input_files import parse_yaml
from tests.recovery.stand_ins import SPEC
from tests.service.server.service_process import TOKEN, ServiceProcess, running_service

API = "/api/v1"
SIGNED = {"Authorization": f"Bearer {TOKEN}"}
SECRET = "a secret beside the service"
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.fixture(scope="module")
def secret(service: ServiceProcess) -> Path:
    path = service.home.parent / "secret.txt"
    path.write_text(SECRET)
    (service.home / "secret.yaml").write_text(SECRET)
    return path


def raw(service: ServiceProcess, method: str, path: str, **more: Any) -> tuple[int, bytes]:
    """Send a request without normalising its path."""
    where = urlsplit(service.url)
    connection = http.client.HTTPConnection(str(where.hostname), where.port, timeout=30)
    try:
        connection.putrequest(method, path, skip_host="Host" in more.get("headers", {}))
        body = more.get("body", b"")
        for name, value in (
            SIGNED | {"Content-Length": str(len(body))} | more.get("headers", {})
        ).items():
            connection.putheader(name, value)
        connection.endheaders(body or None)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


UP = [
    "..",
    "%2e%2e",
    "%2E%2E%2F",
    "..%2f",
    "..%5c",
    "....//",
    "%252e%252e",
    "..;",
    "%00",
    ".service",
]


@pytest.mark.parametrize("up", UP)
@pytest.mark.parametrize(
    "path",
    [
        "/jobs/{up}/files/secret.yaml",
        "/jobs/{up}/journal",
        "/jobs/{up}/results",
        "/jobs/calm/files/{up}",
        "/jobs/calm/files/{up}/secret.yaml",
        "/jobs/calm/files/{up}%2f{up}%2fsecret.txt",
        "/uploads/{up}/secret.yaml",
    ],
)
def test_rejects_paths_outside_home(
    service: ServiceProcess, secret: Path, path: str, up: str
) -> None:
    for method in ("GET", "PUT", "DELETE"):
        status, body = raw(service, method, API + path.format(up=up), body=b"name: x\n")
        assert 400 <= status < 500, (method, path, status)
        assert SECRET.encode() not in body
    assert secret.read_text() == (service.home / "secret.yaml").read_text() == SECRET


@pytest.mark.parametrize(
    "volume",
    [
        "/etc/passwd", "~/.ssh/id_rsa", "../../secret.txt", "a/../../b.nrrd", "C:\\\\boot.ini",
        "file:///etc/passwd", "s3://bucket/x", "nix/scan.nrrd",
        ".service/tokens.json", "\\\\\\\\host\\\\x",
    ],
)  # fmt: skip
def test_rejects_studies_that_name_files_on_the_server(
    client: Client, secret: Path, volume: str
) -> None:
    case = f'case: {{reference: {{volume: "{volume}", spacing_mm: 1}}, mesh: {{nodes: 2000}}}}'
    text = SPEC.replace("case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}", case)
    with pytest.raises(InputError, match=r"points outside|neither an upload"):
        client.submit_study(text)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scan.nhdr", b"NRRD0004\ndata file: /etc/passwd\n"),
        ("scan.nrrd", b"NRRD0004\ntype: uint8\ndata file: ../../secret.txt\n\n"),
        ("scan.nrrd", b"NRRD0004\r\ntype: uint8\r\ndatafile:/etc/passwd\r\n\r\n"),
        ("scan.tif", b'II*\0<UUID FileName="/etc/passwd">'),
        ("case.yaml", b"scans: {reference: ../../secret.txt}\n"),
        ("case.json", b'{"scans": {"reference": "/etc/passwd"}}'),
        ("case.yaml", BOMB.encode()),
        ("case.yaml", b"\xff\xfe\x00"),
        ("tool.py", b"print()"),
        ("scan.nrrd.exe", b""),
    ],
)
def test_rejects_uploads_with_outside_paths(
    service: ServiceProcess, name: str, content: bytes
) -> None:
    path = f"{API}/uploads/bad/{name}"
    answer = httpx.put(service.url + path, content=content, headers=SIGNED)
    assert answer.status_code == 422, answer.text
    assert not (service.home / ".service" / "uploads" / "bad" / name).exists()


@pytest.fixture
def empty_service(tmp_path: Path) -> Iterator[ServiceProcess]:
    """A service without uploads from other tests, which count towards its limits."""
    with running_service(tmp_path / "runs", ["--workers", "1"]) as served:
        yield served


def test_an_upload_is_never_too_large_and_never_changed(empty_service: ServiceProcess) -> None:
    service = empty_service
    folder = service.home / ".service" / "uploads" / "large"
    where = f"{service.url}{API}/uploads/large"
    too_much = b"x" * (2**20 + 1)

    def chunks() -> Any:
        for _ in range(3):
            yield too_much[: 2**19]

    for content in (too_much, chunks()):
        answer = httpx.put(f"{where}/a.csv", content=content, headers=SIGNED)
        assert answer.status_code == 413
        assert not (folder / "a.csv").exists()
    for number in range(5):
        answer = httpx.put(f"{where}/{number}.csv", content=too_much[:-9], headers=SIGNED)
        assert answer.status_code == (201 if number < 4 else 413)
    assert httpx.put(f"{where}/0.csv", content=b"other", headers=SIGNED).status_code in (409, 413)
    assert len(list(folder.iterdir())) == 4  # and nothing half written
    assert httpx.delete(where, headers=SIGNED).status_code == 204
    assert httpx.put(f"{where}/0.csv", content=b"1", headers=SIGNED).status_code == 201
    assert httpx.put(f"{where}/0.csv", content=b"1", headers=SIGNED).status_code == 201
    assert httpx.put(f"{where}/0.csv", content=b"2", headers=SIGNED).status_code == 409
    body = json.dumps({"study": "x" * 2**18})
    assert httpx.post(service.url + API + "/studies", content=body, headers=SIGNED).status_code in (
        413,
        422,
    )


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "a: b: c", "name: [", "\t- x", BOMB, "[" * 5000, "{a: " * 3000, "? " * 3000,
        "name: !!python/object/apply:os.system [id]", "name: 2001-99-99", "name: " + "9" * 5000,
        "&a [*a]", "<<: {a: 1}", "name: \\0", "- " * 20000, "%YAML 9.9\n---\nx", "name: .inf",
        "name: {? {a: b} : c}", SPEC.replace("12", "100000000"),
        SPEC.replace("5\n", "1000000000\n"),
        SPEC.replace("seed: 7", "seed: 1e999"), SPEC + "name: twice\n",
    ],
)  # fmt: skip
def test_malformed_studies_are_refused(service: ServiceProcess, text: str) -> None:
    answer = httpx.post(
        f"{service.url}{API}/studies", json={"study": text}, headers=SIGNED, timeout=20
    )
    assert answer.status_code == 422, (text[:60], answer.text[:300])
    assert len(answer.json()["error"]) < 5000


def test_rejects_bodies_that_are_not_json(service: ServiceProcess) -> None:
    headers = SIGNED | {"Content-Type": "application/json"}
    for body in (b"", b"{", b"\xff", b"[" * 60_000, b'{"study": NaN}', b"null", b'{"study": {}}'):
        answer = httpx.post(f"{service.url}{API}/studies", content=body, headers=headers)
        assert answer.status_code in (400, 422), body[:20]
    deep: Any = "x"
    for _ in range(500):
        deep = {"case": deep}
    answer = httpx.post(f"{service.url}{API}/studies", json={"study": deep}, headers=headers)
    assert answer.status_code == 422


WRITES = [
    ("POST", "/studies"),
    ("POST", "/diagnoses"),
    ("POST", "/jobs/calm/cancel"),
    ("PATCH", "/jobs/calm"),
    ("PUT", "/uploads/f/a.csv"),
    ("DELETE", "/uploads/f"),
]


@pytest.mark.parametrize(("method", "path"), WRITES)
def test_writing_needs_a_token(service: ServiceProcess, method: str, path: str) -> None:
    bad: list[dict[str, str]] = [
        {},
        {"Authorization": "Bearer wrong"},
        {"Authorization": f"Basic {TOKEN}"},
        {"Authorization": f"Bearer {TOKEN[:-1]}"},
        {"Cookie": "palpate_token=wrong"},
        {"X-Token": TOKEN},
    ]
    for headers in bad:
        answer = httpx.request(method, service.url + API + path, json={}, headers=headers)
        assert answer.status_code == 401, (headers, answer.text)
        assert answer.headers["WWW-Authenticate"] == "Bearer"
    assert httpx.get(f"{service.url}{API}/jobs?token={TOKEN}").status_code == 200
    assert not (service.home / ".service" / "uploads" / "f").exists()


def test_rejects_writes_from_other_sites(service: ServiceProcess) -> None:
    signed_in = httpx.post(f"{service.url}{API}/session", json={"token": TOKEN})
    assert signed_in.status_code == 204
    cookie = signed_in.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    jar = {"Cookie": cookie.partition(";")[0]}
    form = "application/x-www-form-urlencoded"
    forged = [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site", "Content-Type": form},
        {"Origin": "https://evil.example", "Content-Type": "text/plain"},
    ]
    for headers in forged:
        answer = httpx.post(
            f"{service.url}{API}/studies",
            content=json.dumps({"study": SPEC}),
            headers=jar | headers,
        )
        assert answer.status_code == 403, headers
    preflight = httpx.options(
        f"{service.url}{API}/studies",
        headers={"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"},
    )
    assert not [name for name in preflight.headers if name.lower().startswith("access-control")]
    own = httpx.put(
        f"{service.url}{API}/uploads/own/a.csv", content=b"1", headers=jar | {"Origin": service.url}
    )
    assert own.status_code == 201


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "[", "a b"])
def test_rejects_unknown_host_names(service: ServiceProcess, host: str) -> None:
    status, _ = raw(service, "GET", f"{API}/health", headers={"Host": host})
    assert status in (400, 421)


def test_reports_run_without_session_cookie(service: ServiceProcess, client: Client) -> None:
    job = client.submit_study(SPEC.replace("name: demo", "name: sandboxed"))
    list(client.follow(job.id))
    answer = httpx.get(f"{service.url}{API}/jobs/sandboxed/files/study.yaml")
    assert answer.headers["content-security-policy"].startswith("sandbox")
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_damaged_journals_and_zarr_are_named_and_not_served(
    service: ServiceProcess, client: Client
) -> None:
    folder = service.home / "store" / "volumes" / "broken.zarr"
    folder.mkdir()
    (folder / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attr')
    text = SPEC.replace("name: demo", "name: broken").replace(
        "{phantom: {preset: 445ml}}", "{volume: broken}"
    )
    job = client.submit_study(text.replace("name: broken", "name: unreadable"))
    list(client.follow(job.id))
    failed = client.job(job.id)
    assert failed.state == "failed"
    assert "Traceback" not in (failed.reason or "")
    job = client.submit_study(SPEC.replace("name: demo", "name: broken"))
    list(client.follow(job.id))
    journal = service.home / "broken" / "journal.jsonl"
    journal.write_bytes(b"\x00garbage\n" + journal.read_bytes())
    for path in ("", "/results", "/journal", "/candidates/1"):
        answer = httpx.get(f"{service.url}{API}/jobs/broken{path}")
        assert answer.status_code in (200, 409), path
        assert "Traceback" not in answer.text
    assert httpx.get(f"{service.url}{API}/jobs").status_code == 200
    assert httpx.get(f"{service.url}/metrics").status_code == 200


def test_a_link_in_the_folder_of_a_job_is_not_followed(
    service: ServiceProcess, client: Client, secret: Path
) -> None:
    job = client.submit_study(SPEC.replace("name: demo", "name: linked"))
    list(client.follow(job.id))
    (service.home / "linked" / "report.html").symlink_to(secret)
    answer = httpx.get(f"{service.url}{API}/jobs/linked/files/report.html")
    assert answer.status_code in (404, 409)
    assert SECRET not in answer.text


def test_untrusted_yaml_has_no_aliases_and_no_outside_paths() -> None:
    assert parsed_text("a: [1, {b: x}]", "it") == {"a": [1, {"b": "x"}]}
    with pytest.raises(InputError, match="anchors or aliases"):
        parsed_text("a: &x 1\nb: *x\n", "it")
    refuse_paths({"a": ["x/y.nrrd", "1/2", "a..b", 3, None]}, "it")
    for text in ("/x", " /x", "a/../b", "..", "~", "x/..", "http://x", "a\0b"):
        with pytest.raises(InputError, match="points outside"):
            refuse_paths({"a": [text]}, "it")


def test_the_depth_limit_of_a_newer_libyaml_has_the_same_message(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def parse(*_: Any) -> Any:
        raise yaml.YAMLError("while increasing flow level\nexceeded maximum nesting depth")

    monkeypatch.setattr(yaml, "parse", parse)
    for read in (parsed_text, parse_yaml):
        with pytest.raises(InputError, match="is nested too deeply"):
            read("[", "study.yaml")
