"""Commands on a store in a bucket; an unusable one gives one message and exit code 2."""

import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest

from palpate.service.study import store_use
from palpate.storage.backends import bucket_client
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import has_field, save_field
from tests.recovery.stand_ins import Inline, run, told
from tests.storage.object_server import set_environment

Call = Callable[..., tuple[int, str, str]]


@contextmanager
def server_of(answer: Callable[[BaseHTTPRequestHandler], None]) -> Iterator[str]:
    """Start an HTTP server and provide its address."""

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    for method in ("GET", "PUT", "HEAD", "POST", "DELETE"):
        setattr(Handler, f"do_{method}", answer)
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def send(handler: BaseHTTPRequestHandler, status: int, body: bytes, headers: Any = ()) -> None:
    handler.send_response(status)
    for name, value in headers:
        if name.lower() not in ("transfer-encoding", "content-length", "connection", "date"):
            handler.send_header(name, value)
    handler.send_header("Content-Length", str(len(body)))
    handler.end_headers()
    if handler.command != "HEAD":
        handler.wfile.write(body)


def deny(handler: BaseHTTPRequestHandler) -> None:
    handler.rfile.read(int(handler.headers.get("Content-Length", 0)))
    send(handler, 403, b"<Error><Code>InvalidAccessKeyId</Code></Error>")


def without_conditions(address: str) -> Callable[[BaseHTTPRequestHandler], None]:
    """Forward requests to `address` without the header If-None-Match, like some servers."""

    def forward(handler: BaseHTTPRequestHandler) -> None:
        body = handler.rfile.read(int(handler.headers.get("Content-Length", 0)))
        headers = {n: v for n, v in handler.headers.items() if n.lower() != "if-none-match"}
        headers.setdefault("Content-Type", "application/octet-stream")
        asked = Request(address + handler.path, body, headers, method=handler.command)
        try:
            with urlopen(asked) as answer:
                send(handler, answer.status, answer.read(), answer.headers.items())
        except HTTPError as error:
            send(handler, error.code, error.read(), error.headers.items())

    return forward


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limit the time for unreachable addresses to half a second."""
    monkeypatch.setattr(bucket_client, "FIRST_PATIENCE_S", 0.5)


@pytest.fixture
def study(bucket: str, tmp_path: Path) -> Path:
    """Provide a completed study with fields and a store in a bucket."""
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline(), store=f"{bucket}/store")
    store = open_store(f"{bucket}/store")
    for number, entry in enumerate(store.backend.entries(store.layout.evaluations)):
        save_field(store, entry.place.stem, np.full((4, 3), float(number)))
    return folder


def test_unusable_store_gives_one_message(
    call: Call, bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place, words in (
        ("s3://no-such-bucket/store", "There is no bucket no-such-bucket"),
        (f"{bucket}/nothing-there", "has no palpate-store.json"),
        ("s3://x", "names no bucket"),
        ("gcs://bucket/store", "local folders and in object stores only"),
    ):
        code, out, err = call("store", "check", "--store", place)
        assert (code, out, words in err, "Traceback" in err) == (2, "", True, False), err
        assert len(err.strip().splitlines()) <= 3
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    code, _, err = call("store", "check", "--store", "s3://other-bucket/store")
    assert (code, "cannot be reached at http://127.0.0.1:9" in err) == (2, True)
    with server_of(deny) as address:
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
        code, _, err = call("store", "check", "--store", f"{bucket}/store")
    assert (code, "denies access (InvalidAccessKeyId)" in err) == (2, True)
    assert "AWS_ACCESS_KEY_ID" in err


def test_credentials_come_from_environment_or_profile(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    signed: list[str] = []

    def note(handler: BaseHTTPRequestHandler) -> None:
        _, _, credential = handler.headers["Authorization"].partition("Credential=")
        signed.append(credential.split("/aws4")[0])
        deny(handler)

    set_environment({"HOME": str(tmp_path)}, monkeypatch)
    (tmp_path / ".aws").mkdir()
    keys = "[lab]\naws_access_key_id=of-the-profile\naws_secret_access_key=x\nregion=eu-west-1\n"
    with server_of(note) as address:
        (tmp_path / ".aws" / "credentials").write_text(f"{keys}endpoint_url={address}\n")
        monkeypatch.setenv("AWS_PROFILE", "lab")
        code, _, err = call("store", "check", "--store", "s3://bucket/store")
        assert (code, f"{address} denies access" in err, "AWS_PROFILE" in err) == (2, True, True)
        for name, value in (("ENDPOINT_URL", address), ("SECRET_ACCESS_KEY", "y")):
            monkeypatch.setenv(f"AWS_{name}", value)
        monkeypatch.setenv("AWS_ACCESS_KEY_ID", "of-the-environment")
        call("store", "check", "--store", "s3://bucket/store")
    assert {tuple(one.split("/")[::2]) for one in signed} == {
        ("of-the-profile", "eu-west-1"),
        ("of-the-environment", "us-east-1"),
    }
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.setenv("AWS_PROFILE", "lob")
    code, _, err = call("store", "check", "--store", "s3://bucket/store")
    assert (code, "There is no profile lob in" in err, "Traceback" in err) == (2, True, False)


def test_error_names_google_and_azure_credentials(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in [name for name in os.environ if name.startswith(("AZURE_", "GOOGLE_"))]:
        monkeypatch.delenv(name)
    code, _, err = call("store", "check", "--store", "az://lab/store")
    assert (code, "AZURE_STORAGE_ACCOUNT_NAME" in err, "Debug" in err) == (2, True, False)
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_NAME", "lab")
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "a2V5")
    monkeypatch.setenv("AZURE_STORAGE_ENDPOINT", "http://127.0.0.1:9")
    code, _, err = call("store", "check", "--store", "az://lab/store")
    assert (code, "cannot be reached at http://127.0.0.1:9" in err) == (2, True)
    key = tmp_path / "missing.json"
    monkeypatch.setenv("GOOGLE_APPLICATION_CREDENTIALS", str(key))
    code, _, err = call("store", "check", "--store", "gs://lab/store")
    assert (code, str(key) in err, "Debug" in err) == (2, True, False)
    no_container = b"<Error><Code>ContainerNotFound</Code></Error>"
    with server_of(lambda handler: send(handler, 404, no_container)) as address:
        monkeypatch.setenv("AZURE_STORAGE_ENDPOINT", address)
        code, _, err = call("store", "check", "--store", "az://lab/store")
    assert (code, f"There is no bucket lab at {address}" in err) == (2, True)


@pytest.mark.parametrize("scheme", ["s3", "gs", "az"])
def test_error_explains_installing_obstore(
    call: Call, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "obstore.store", None)
    monkeypatch.delattr("obstore.store", raising=False)
    bucket_client._client.cache_clear()
    code, _, err = call("store", "check", "--store", f"{scheme}://lab/store")
    assert (code, "pip install 'palpate[cloud]'" in err) == (2, True)


def test_doctor_reports_conditional_put(
    call: Call, bucket: str, object_server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from palpate.service.cluster.doctor_checks import _store_problems, try_store

    facts = try_store(f"{bucket}/store")
    assert facts == {"root": f"{bucket}/store", "free_bytes": None, "takes_once": True}
    assert _store_problems(facts) == []
    with server_of(without_conditions(object_server.environment["AWS_ENDPOINT_URL"])) as address:
        set_environment(object_server.environment | {"AWS_ENDPOINT_URL": address}, monkeypatch)
        facts = try_store(f"{bucket}/store")
        assert not facts["takes_once"]
        (problem,) = _store_problems(facts)
        assert "ignores If-None-Match" in problem


@pytest.mark.slow
def test_damage_is_set_aside_and_garbage_removed(call: Call, study: Path, bucket: str) -> None:
    place = f"{bucket}/store"
    code, out, _ = call("store", "check", "--store", place)
    assert (code, "all is well" in out) == (0, True)
    store = open_store(place)
    name = next(ending[2] for ending in told(study).values() if ending[3] == "done")
    store.backend.remove(store.layout.field(name))
    code, _, err = call("store", "check", "--store", place)
    assert (code, name in err) == (2, True)
    code, out, _ = call("store", "check", "--store", place, "--repair", "--json")
    assert (code, json.loads(out)["set_aside"]) == (0, f"{place}/damaged")
    save_field(store, "part", np.zeros((2, 3)))
    wanted = ["--store", place, "--older-than-days", "0"]
    code, out, _ = call("store", "gc", *wanted, "--json")
    found = json.loads(out)
    assert code == 0
    # The derivatives at the best candidate do not belong to a candidate.
    assert f"{place}/fields/part.zarr" in found["entries"]
    assert found["bytes"] > 100
    assert has_field(store, "part")
    assert call("store", "gc", *wanted, "--delete")[0] == 0
    assert not has_field(store, "part")
    kept = [e[2] for e in told(study).values() if e[3] == "done" and e[2] != name]
    assert all(has_field(store, digest) for digest in kept)
    code, out, _ = call("store", "migrate", "--store", place)
    assert (code, "nothing to do" in out) == (0, True)


@pytest.mark.parametrize("target", ["folder", "bucket"])
def test_a_study_moves_between_bucket_and_folder(
    call: Call, study: Path, bucket: str, tmp_path: Path, target: str
) -> None:
    assert call("store", "export", "demo", "--out", "demo.tar")[0] == 0
    place = str(tmp_path / "new" / "store") if target == "folder" else f"{bucket}/elsewhere"
    moved = tmp_path / "new" / "demo"
    code, _, err = call("store", "import", "demo.tar", "--study", moved, "--store", place)
    assert code == 0, err
    assert told(moved) == told(study)
    assert call("store", "check", "--store", place)[0] == 0
    there = open_store(place, create=False)
    done = {e[2] for e in told(study).values() if e[3] == "done"}
    assert all(has_field(there, digest) for digest in done)
    assert json.loads(call("status", moved, "--json")[1])["store"] == place
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".tmp")] == []


def test_removes_old_partial_files(
    call: Call, study: Path, bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(f"{bucket}/store")
    half = store.layout.field("half")
    store.backend.write(half / "w-0" / "displacement_mm" / "zarr.json", b"{}")
    wanted = ["store", "gc", "--store", f"{bucket}/store", "--delete", "--json"]
    assert json.loads(call(*wanted)[1])["entries"] == []
    monkeypatch.setattr(store_use, "DAY_S", -60.0)  # a minute from now is a day ago
    assert str(half) in json.loads(call(*wanted, "--older-than-days", "0")[1])["entries"]
    names = [entry.place.name for entry in store.backend.entries(store.layout.fields)]
    assert names
    assert "half.zarr" not in names
