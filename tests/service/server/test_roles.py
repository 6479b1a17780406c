"""Roles of tokens, and information that messages and helpers may reveal."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from fastapi import HTTPException

from palpate.service.server.api_models import public_text
from palpate.service.server.http.request_checks import check_may_change, still_reads, writer
from palpate.service.server.jobs.home_and_tokens import (
    Owner,
    Tokens,
    helper_command,
    helper_environment,
    take_token,
)
from palpate.service.server.jobs.job_queue import Job
from palpate.service.server.jobs.study_and_diagnosis_jobs import ReportError, write_report
from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import dumps


def job(owner: str) -> Job:
    return Job(id="j", kind="study", owner=owner, priority=0, submitted="", request={})


def test_roles_are_kept_and_tokens_of_older_versions_can_submit(tmp_path: Path) -> None:
    tokens = Tokens(tmp_path / "tokens.json", "")
    made = {role: tokens.new(role, role) for role in ("read", "submit", "admin")}
    again = Tokens(tmp_path / "tokens.json", "x" * 20)
    assert {r: again.holder(t) for r, t in made.items()} == {r: Owner(r, r) for r in made}
    assert again.holder("x" * 20) == Owner("environment", "admin")
    assert again.roles["environment"] == "admin"
    old = {"ann": again._known["read"][0]}
    (tmp_path / "tokens.json").write_text(dumps({"tokens": old}))
    assert Tokens(tmp_path / "tokens.json", "").holder(made["read"]) == Owner("ann", "submit")
    (tmp_path / "tokens.json").write_text('{"tokens": {"ann": {"sha256": "x", "role": "king"}}}')
    with pytest.raises(StoreError, match="damaged"):
        Tokens(tmp_path / "tokens.json", "")


def test_only_the_submitter_or_an_admin_changes_a_job() -> None:
    reader, ann, bob = Owner("eve", "read"), Owner("ann", "submit"), Owner("bob", "submit")
    admin = Owner("root", "admin")
    check_may_change(ann, job("ann"))
    check_may_change(admin, job("ann"))
    for owner in (bob, reader, Owner("ann", "read")):
        with pytest.raises(HTTPException) as refused:
            check_may_change(owner, job("ann"))
        assert refused.value.status_code == 403
    assert writer(ann) == ann
    with pytest.raises(HTTPException, match="is read-only"):
        writer(reader)


def test_streams_end_when_their_token_is_removed(tmp_path: Path) -> None:
    class Stub:
        def __init__(self, **values: Any) -> None:
            self.__dict__.update(values)

    tokens = Tokens(tmp_path / "tokens.json", "")
    token = tokens.new("ann", "read")
    service: Any = Stub(tokens=tokens, read_token=True)
    signed: Any = Stub(headers={"Authorization": f"Bearer {token}"}, cookies={})
    cookie: Any = Stub(headers={}, cookies={"palpate_token": token})
    stranger: Any = Stub(headers={}, cookies={})
    assert [still_reads(r, service) for r in (signed, cookie, stranger)] == [True, True, False]
    tokens.remove("ann")
    assert [still_reads(r, service) for r in (signed, cookie)] == [False, False]
    service.read_token = False
    assert still_reads(stranger, service)


def test_removes_token_from_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PALPATE_TOKEN", "x" * 20)
    assert take_token() == "x" * 20
    assert "PALPATE_TOKEN" not in os.environ
    assert take_token() == ""
    (tmp_path / "token").write_text("y" * 20 + "\n")
    monkeypatch.setenv("PALPATE_TOKEN_FILE", str(tmp_path / "token"))
    assert take_token() == "y" * 20
    assert "PALPATE_TOKEN_FILE" not in os.environ
    monkeypatch.setenv("PALPATE_TOKEN_FILE", str(tmp_path / "nothing"))
    with pytest.raises(InputError, match="PALPATE_TOKEN_FILE"):
        take_token()


def test_messages_show_no_path_and_no_traceback() -> None:
    shown = public_text(
        "A task crashed on /home/ann/runs/.service/uploads/f/case.yaml (in '/etc/x/y.py'):\n"
        'Traceback (most recent call last):\n  File "/opt/palpate/x.py", line 3'
    )
    assert shown == "A task crashed on case.yaml (in 'y.py'):"
    for text in ("0.5 N/mm", "and/or", "s3://bucket/store", "a / b", "FOLDER/FILE"):
        assert public_text(text) == text


def test_a_helper_imports_nothing_from_the_folder_it_runs_in(tmp_path: Path) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('code of the folder')")
    (tmp_path / "palpate.py").write_text("raise SystemExit('code of the folder')")
    command = helper_command("palpate", "--version")
    assert command[:3] == [sys.executable, "-P", "-m"]
    ended = subprocess.run(
        command, env=helper_environment(), cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith("palpate ")


def test_reports_a_page_that_could_not_be_written(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="Error"):
        write_report(tmp_path, False)


def test_short_tokens_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 16"):
        Tokens(tmp_path / "tokens.json", "short")
