"""The compose file is valid, its services fit together, and its commands run.

There is no Docker engine where these tests run, so images are not built here. The
scheduler, a worker and their health checks are started as processes of this machine
instead, with the exact commands of the file.
"""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import dask.config
import pytest
import yaml

from palpate.service.cluster import container_retry
from palpate.service.cluster.dask_cluster import CONFIG
from palpate.service.remote_client import Client
from palpate.workers import WORKER_ENVIRONMENT

ROOT = Path(__file__).parents[2]
COMPOSE = ROOT / "docker-compose.yml"
BIN = Path(sys.executable).parent
VERSION, DIGEST = r".+:v?\d+\.\d+\.\d+", "@sha256:[0-9a-f]{64}"
ENDING = ("driver", "bucket")  # services that end by themselves


def interpolated(text: str) -> str:
    """Replace ``${NAME:-default}`` by its default, as compose does."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(interpolated(COMPOSE.read_text()))
    return loaded


def ours(compose: dict[str, Any]) -> dict[str, Any]:
    """Return the services that run palpate's image."""
    services = compose["services"].items()
    return {name: service for name, service in services if service["image"].startswith("palpate:")}


def misspelt(tmp_path: Path) -> Path:
    """A copy with one wrong key, which any useful validator must reject."""
    copy = tmp_path / "docker-compose.yml"
    copy.write_text(COMPOSE.read_text().replace("depends_on:", "depend_on:", 1))
    return copy


# --- the specification ---------------------------------------------------------


def test_conforms_to_the_schema_of_the_compose_specification(tmp_path: Path) -> None:
    pytest.importorskip(
        "check_jsonschema", reason="check-jsonschema, which holds the schema, is not installed"
    )
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    good = subprocess.run([*check, COMPOSE], capture_output=True, text=True, check=False)
    assert good.returncode == 0, good.stdout
    bad = subprocess.run([*check, misspelt(tmp_path)], capture_output=True, text=True, check=False)
    assert bad.returncode == 1
    assert "'depend_on' was unexpected" in bad.stdout


def test_docker_compose_accepts_the_file(tmp_path: Path) -> None:
    docker = shutil.which("docker")
    version = [docker or "docker", "compose", "version"]
    if docker is None or subprocess.run(version, capture_output=True, check=False).returncode:
        pytest.skip("the compose plugin of docker is not installed")
    config = [docker, "compose", "-f"]
    good = subprocess.run(
        [*config, COMPOSE, "config", "--format", "json"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"WORKERS": "7"},
    )
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["services"]["worker"]["deploy"]["replicas"] == 7
    bad = subprocess.run(
        [*config, misspelt(tmp_path), "config", "-q"], capture_output=True, check=False
    )
    assert bad.returncode == 1


# --- how it is wired -------------------------------------------------------------


def test_has_one_scheduler_one_service_and_scalable_workers(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert set(services) == {"scheduler", "worker", "service", "driver", "bucket", "objects"}
    profiles = {name: service.get("profiles") for name, service in services.items()}
    assert [name for name, wanted in profiles.items() if not wanted] == [
        *("scheduler", "worker", "service")  # what `up` starts
    ]
    assert profiles["bucket"] == profiles["objects"] == ["objects"]
    assert services["worker"]["deploy"]["replicas"] >= 1
    # A fixed name or a published port would make --scale fail at the second worker.
    assert "container_name" not in services["worker"]
    assert "ports" not in services["worker"]
    assert len({service["image"] for service in ours(compose).values()}) == 1
    for service in services.values():
        assert re.fullmatch(rf"{VERSION}({DIGEST})?", service["image"])
    assert re.fullmatch(f"{VERSION}{DIGEST}", services["objects"]["image"])


def test_every_service_waits_for_its_dependencies(compose: dict[str, Any]) -> None:
    services = compose["services"]
    waits = {name: set(service.get("depends_on", {})) for name, service in services.items()}
    assert waits == {
        "scheduler": set(),
        "worker": {"scheduler"},
        "service": {"scheduler"},
        "driver": {"scheduler", "worker"},
        "bucket": set(),
        "objects": {"bucket"},
    }
    for service in services.values():
        for needed, how in service.get("depends_on", {}).items():
            if needed in ENDING:
                assert how == {"condition": "service_completed_successfully"}
            else:
                assert how == {"condition": "service_healthy"}
                assert "test" in services[needed]["healthcheck"]


def test_all_services_share_the_store_and_set_the_safe_path(compose: dict[str, Any]) -> None:
    assert list(compose["volumes"]) == ["data", "objects", "cache"]
    for name, service in ours(compose).items():
        assert ("data:/data" in service["volumes"]) == (name != "bucket")
        assert service["environment"]["PYTHONSAFEPATH"] == "1"


def test_the_object_store_and_its_clients_have_matching_settings(compose: dict[str, Any]) -> None:
    text = COMPOSE.read_text()
    services = compose["services"]
    objects = services["objects"]
    assert objects["user"] == "1000:1000"
    assert objects["volumes"] == services["bucket"]["volumes"] == ["objects:/objects"]
    assert objects["command"][-1] == "/objects"
    bucket = services["bucket"]["command"][-1].removeprefix("/objects/")
    assert f"PALPATE_STORE=s3://{bucket}/store docker compose --profile objects up" in text
    port = objects["environment"]["VGW_PORT"]
    assert f"127.0.0.1{port}/health" in objects["healthcheck"]["test"][-1]
    for name in ("scheduler", "bucket"):  # which read no store
        assert not [key for key in services[name]["environment"] if key.startswith("AWS_")]
    for service in (services["driver"], services["worker"], services["service"]):
        assert service["environment"]["AWS_ENDPOINT_URL"] == f"http://objects{port}"
        assert service["environment"]["AWS_ACCESS_KEY_ID"] == ""
    # Both read the same variables, so they cannot differ.
    for theirs, our in (
        ("ROOT_ACCESS_KEY", "ACCESS_KEY_ID"),
        ("ROOT_SECRET_KEY", "SECRET_ACCESS_KEY"),
    ):
        assert f'{theirs}: "${{AWS_{our}:-}}"' in text
        assert f'AWS_{our}: "${{AWS_{our}:-}}"' in text
    final = (ROOT / "Dockerfile").read_text().rpartition("\nFROM ")[2]
    assert "--owner palpate --group palpate /data /objects " in final


def test_every_service_has_limits_and_a_read_only_file_system(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        limits = service["deploy"]["resources"]["limits"]
        assert limits["cpus"], name
        assert limits["memory"], name
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert service["pids_limit"] <= 1024
        assert any(mount.startswith("/tmp") for mount in service["tmpfs"])
        assert name in ENDING or "test" in service["healthcheck"]
        if name not in ("bucket", "objects"):
            assert "cache:/home/palpate/.cache" in service["volumes"]


def test_the_driver_runs_an_existing_study(compose: dict[str, Any]) -> None:
    command = compose["services"]["driver"]["command"]
    assert command == [
        *("python", "-m", "palpate.service.cluster.container_retry"),
        *("palpate", "run", "/studies/demo.yaml", "--study", "/data/runs/demo"),
        *("--scheduler", "tcp://scheduler:8786", "--store", "/data/store"),
    ]
    assert (ROOT / "examples" / "demo.yaml").exists()


def test_addresses_and_ports_match_between_services(compose: dict[str, Any]) -> None:
    services = compose["services"]
    scheduler = services["scheduler"]["command"]
    port = scheduler[scheduler.index("--port") + 1]
    assert services["worker"]["command"][2] == f"tcp://scheduler:{port}"
    for name in ("service", "driver"):
        assert f"tcp://scheduler:{port}" in services[name]["command"]
    command = services["service"]["command"]
    port = command[command.index("--port") + 1]
    assert f"localhost:{port}/api/v1/health" in services["service"]["healthcheck"]["test"][-1]
    for name in ("scheduler", "worker"):
        command = services[name]["command"]
        page = command[command.index("--dashboard-address") + 1]
        assert f"localhost{page}/health" in services[name]["healthcheck"]["test"][-1]


def test_ports_are_open_to_this_machine_only(compose: dict[str, Any]) -> None:
    assert compose["services"]["scheduler"]["ports"] == ["127.0.0.1:8787:8787"]
    assert compose["services"]["service"]["ports"] == ["127.0.0.1:8780:8780"]


def test_the_token_is_a_secret_and_the_cluster_has_its_own_network(compose: dict[str, Any]) -> None:
    assert compose["x-required"][0].startswith("${PALPATE_TOKEN:?")
    assert compose["secrets"] == {"palpate_token": {"environment": "PALPATE_TOKEN"}}
    for name, service in compose["services"].items():
        assert "PALPATE_TOKEN" not in service["environment"], name
        assert service.get("secrets", []) == (["palpate_token"] if name == "service" else [])
        published = name in ("scheduler", "service")
        assert service["networks"] == ["cluster", *(["outside"] if published else [])]
    assert compose["services"]["service"]["environment"]["PALPATE_TOKEN_FILE"] == (
        "/run/secrets/palpate_token"
    )
    assert compose["networks"]["cluster"] == {"internal": True}


def test_a_worker_runs_one_evaluation_within_its_memory_limit(compose: dict[str, Any]) -> None:
    worker = compose["services"]["worker"]
    command = worker["command"]
    for option in ("--nthreads", "--nworkers"):
        assert command[command.index(option) + 1] == "1"
    limit = command[command.index("--memory-limit") + 1]
    assert limit == worker["deploy"]["resources"]["limits"]["memory"]


def test_dask_settings_match_those_of_a_local_cluster(compose: dict[str, Any]) -> None:
    for name in ("scheduler", "worker"):
        told = dask.config.collect_env(compose["services"][name]["environment"])
        for key, value in CONFIG.items():
            if key.startswith(("distributed.scheduler.", "distributed.worker.")):
                assert dask.config.get(key, config=told) == value, key


def test_the_image_limits_evaluations_to_one_thread() -> None:
    final = (ROOT / "Dockerfile").read_text().rpartition("\nFROM ")[2]
    for name, value in WORKER_ENVIRONMENT.items():
        assert f"{name}={value}" in final
    assert "PYTHONSAFEPATH=1" in final
    assert re.search(r"^USER [1-9]\d*$", final, re.MULTILINE), "the image must not run as root"


def test_the_image_has_one_base_pinned_by_digest() -> None:
    bases = re.findall(r"^FROM (\S+)", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert len(bases) == 2
    assert len(set(bases)) == 1
    assert re.fullmatch(rf"python:\d+\.\d+\.\d+-slim-\w+{DIGEST}", bases[0])


def test_the_build_context_has_exactly_the_copied_files() -> None:
    allowed = {
        line[1:].strip("/")
        for line in (ROOT / ".dockerignore").read_text().splitlines()
        if line.startswith("!")
    }
    copied: set[str] = set()
    for line in (ROOT / "Dockerfile").read_text().splitlines():
        if line.startswith("COPY ") and "--from" not in line:
            copied |= {source.strip("/") for source in line.split()[1:-1]}
    assert copied == allowed
    for name in copied:
        assert (ROOT / name).exists(), name


def exits(tmp_path: Path, *codes: int) -> list[str]:
    """Return a command that exits with the next of these codes at each call."""
    script = (
        "import pathlib, sys; count = pathlib.Path(sys.argv[1]); "
        "count.write_text(count.read_text() + '.' if count.exists() else '.'); "
        "sys.exit([int(c) for c in sys.argv[2:]][len(count.read_text()) - 1])"
    )
    return [sys.executable, "-c", script, str(tmp_path / "count"), *map(str, codes)]


@pytest.mark.parametrize(
    ("codes", "started", "ended"),
    [([2, 0], 1, 2), ([0], 1, 0), ([130, 0], 1, 130), ([1, 1, 0], 3, 0), ([1] * 5, 4, 1)],
)
def test_user_errors_are_not_retried_but_other_failures_are(
    compose: dict[str, Any], tmp_path: Path, codes: list[int], started: int, ended: int
) -> None:
    assert compose["services"]["driver"]["restart"] == "no"
    assert container_retry.main(exits(tmp_path, *codes), pause_s=0.0) == ended
    assert len((tmp_path / "count").read_text()) == started


# --- the commands ----------------------------------------------------------------


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    program = [str(BIN / command[0]), *command[1:]]
    with subprocess.Popen(
        program, env=os.environ | environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def healthy(test: list[str]) -> bool:
    assert test[:2] == ["CMD", "python"]
    done = subprocess.run([sys.executable, *test[2:]], capture_output=True, check=False)
    return done.returncode == 0


def becomes_healthy(test: list[str], patience_s: float = 60) -> bool:
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        if healthy(test):
            return True
        time.sleep(0.2)
    return False


def test_the_commands_start_and_their_health_checks_are_correct(tmp_path: Path) -> None:
    """The file's own commands, with the host and the ports of a container replaced."""
    ports = {name: str(free_port()) for name in ("8780", "8786", "8787", "8788")}
    text = interpolated(COMPOSE.read_text()).replace("tcp://scheduler:", "tcp://127.0.0.1:")
    text = text.replace("/tmp/dask", str(tmp_path / "dask")).replace("0.0.0.0", "127.0.0.1")
    text = re.sub(r"- /data/(\w+)$", rf"- {tmp_path}/\1", text, flags=re.MULTILINE)
    for written, free in ports.items():
        text = re.sub(rf"\b{written}\b", free, text)
    services = yaml.safe_load(text)["services"]
    scheduler, worker = services["scheduler"], services["worker"]

    assert not healthy(scheduler["healthcheck"]["test"])
    with ExitStack() as stack:
        stack.enter_context(running(scheduler["command"], scheduler["environment"]))
        assert becomes_healthy(scheduler["healthcheck"]["test"])
        assert not healthy(worker["healthcheck"]["test"])
        stack.enter_context(running(worker["command"], worker["environment"]))
        assert becomes_healthy(worker["healthcheck"]["test"])
        assert work_done(f"tcp://127.0.0.1:{ports['8786']}") == 5
        service = services["service"]
        assert not healthy(service["healthcheck"]["test"])
        token = {"PALPATE_TOKEN": "a-token-of-the-tests"}
        stack.enter_context(running(service["command"], service["environment"] | token))
        assert becomes_healthy(service["healthcheck"]["test"])
        assert cluster_of(f"http://127.0.0.1:{ports['8780']}", **token) == {"threads": 1}
    assert not healthy(scheduler["healthcheck"]["test"])
    assert not healthy(worker["healthcheck"]["test"])


def cluster_of(url: str, patience_s: float = 60, **token: str) -> dict[str, int]:
    """Return the service's view of its cluster, as soon as it has one."""
    with Client(url, token["PALPATE_TOKEN"]) as client:
        deadline = time.monotonic() + patience_s
        while not (found := client.cluster()).threads and time.monotonic() < deadline:
            time.sleep(0.2)
    return {"threads": found.threads}


def work_done(address: str) -> int:
    """Return a worker's result, from a client in a separate process, which leaves no threads."""
    client = (
        "import sys; from distributed import Client\n"
        "with Client(sys.argv[1], timeout=20) as client:\n"
        "    client.wait_for_workers(1, timeout=30)\n"
        "    print(client.submit(len, 'Lagos').result(timeout=30))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", client, address],
        capture_output=True,
        text=True,
        check=True,
        timeout=90,
    )
    return int(done.stdout)
