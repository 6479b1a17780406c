"""Schemathesis sends what the description of the API allows, and what it does not."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.server.service_process import TOKEN, ServiceProcess

CHECKS = (
    "not_a_server_error,status_code_conformance,content_type_conformance,"
    "response_schema_conformance"
)


@pytest.mark.slow
def test_responses_agree_with_description(service: ServiceProcess, tmp_path: Path) -> None:
    pytest.importorskip("schemathesis", reason="schemathesis is not installed")
    run = subprocess.run(
        [
            *(sys.executable, "-m", "schemathesis.cli", "run"),
            f"{service.url}/api/v1/openapi.json",
            *("--checks", CHECKS, "--max-examples", "3", "--seed", "1"),
            *("--phases", "examples,coverage,fuzzing", "--request-timeout", "20"),
            *("--exclude-path-regex", "/(events|points)$", "-H", f"Authorization: Bearer {TOKEN}"),
        ],
        capture_output=True,
        text=True,
        timeout=240,
        cwd=tmp_path,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-6000:] + run.stderr[-1000:]
