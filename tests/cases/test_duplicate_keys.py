"""Rejection of repeated keys in all YAML and JSON input."""

import asyncio
import json

import httpx
import pytest
from fastapi import APIRouter, FastAPI
from pydantic import BaseModel

from palpate.service.blind.sealed_set import read_json
from palpate.service.server.http import http_server, job_routes, live_page_routes
from palpate.service.server.http.request_checks import StrictRoute
from palpate.service.server.jobs.untrusted_inputs import parsed_text
from palpate.service.study.study_keys import parse_spec
from palpate.storage.errors import InputError
from palpate.workers.input_files import parse_json, parse_yaml
from palpate.workers.organs.breast.scanned_case_files import read_case_file
from palpate.workers.organs.specimen.specimen_keys import read_spec
from palpate.workers.tasks.diagnosis_sources import open_source
from tests.workers.organs.specimen.experiments import described, write

NESTED_YAML = "loads:\n  - force_n: 18\n    file: a\n    force_n: 36\n"
NESTED_JSON = '{"loads": [{"force_n": 18, "file": "a", "force_n": 36}]}'


@pytest.mark.parametrize(
    "text",
    [
        NESTED_YAML,
        "a: 1\nb: 2\na: 1\n",
        "{a: 1, a: 2}",
        'labels: {1: fat, "1": gland}',
        NESTED_JSON,
    ],
)
def test_yaml_refuses_a_repeated_key(text):
    with pytest.raises(InputError, match=r"file: the key '(force_n|a|1)' is repeated on lines"):
        parse_yaml(text, "file")


@pytest.mark.parametrize("text", [NESTED_JSON, '{"force_n": 1, "force_n": 1}', '[[{"a":1,"a":2}]]'])
def test_json_refuses_a_repeated_key(text):
    with pytest.raises(InputError, match=r"case\.json: the key '(force_n|a)' is repeated"):
        parse_json(text, "case.json")


def test_names_the_lines_of_a_repeated_key():
    with pytest.raises(InputError, match=r"'force_n' is repeated on lines 2 and 4\. Keep one"):
        parse_yaml(NESTED_YAML, "file.yaml")


def test_accepts_merge_keys_and_equal_keys_of_different_objects():
    text = "a: &a {x: 1, y: 2}\nb:\n  <<: *a\n  y: 3\nc: {x: 1}\n"
    assert parse_yaml(text, "f") == {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}, "c": {"x": 1}}
    assert parse_json('[{"a": 1}, {"a": 2}]', "f") == [{"a": 1}, {"a": 2}]


def test_experiment_refuses_a_repeated_key(tmp_path):
    path = write(tmp_path, described())
    path.write_text(path.read_text() + "down: [0, 0, -1]\n")
    with pytest.raises(InputError, match=r"experiment\.yaml: the key 'down' is repeated on lines"):
        read_spec(path)
    with pytest.raises(InputError, match="'down' is repeated"):
        open_source(path)


@pytest.mark.parametrize("name", ["case.json", "case.yaml", "other.json"])
def test_case_refuses_a_repeated_key(tmp_path, name):
    path = tmp_path / name
    path.write_text('{"organ": "breast", "scans": {}, "organ": "breast"}')
    for read in (read_case_file, open_source):
        with pytest.raises(InputError, match="the key 'organ' is repeated"):
            read(path)


def test_study_and_upload_refuse_a_repeated_key(tmp_path):
    text = "name: a\nsearch: {seed: 1, seed: 2}\n"
    for read in (lambda: parse_spec(text, "The study", tmp_path), lambda: parsed_text(text, "It")):
        with pytest.raises(InputError, match="the key 'seed' is repeated on lines 2 and 2"):
            read()


def test_record_of_a_blind_set_refuses_a_repeated_key(tmp_path):
    (tmp_path / "truth.json").write_text('{"effect": "a", "effect": "b"}')
    with pytest.raises(InputError, match="'effect' is repeated"):
        read_json(tmp_path / "truth.json")


class _Given(BaseModel):
    study: dict[str, int]


def _answer(content):
    router = APIRouter(route_class=StrictRoute)

    @router.post("/")
    def accept(given: _Given) -> dict[str, int]:
        return given.study

    tested = FastAPI()
    tested.include_router(router)

    async def ask():
        transport = httpx.ASGITransport(tested)
        async with httpx.AsyncClient(transport=transport, base_url="http://here") as client:
            headers = {"content-type": "application/json"}
            return await client.post("/", content=content, headers=headers)

    return asyncio.run(ask())


def test_request_refuses_a_repeated_key():
    assert _answer(json.dumps({"study": {"seed": 1}})).json() == {"seed": 1}
    answer = _answer('{"study": {"seed": 1, "seed": 2}}')
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith("The request: the key 'seed' is repeated")
    assert _answer("{").status_code == 422


def test_every_route_with_a_body_is_strict():
    routers = [job_routes.router, live_page_routes.watch_router, http_server._about()]
    with_body = [r for router in routers for r in router.routes if r.body_field is not None]
    assert len(with_body) >= 3
    assert all(isinstance(route, StrictRoute) for route in with_body)
