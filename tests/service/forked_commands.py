"""Commands as forks of one process with all imports, to save their start-up time.

A fork has its own folder, environment, standard streams and exit code; what it does not have
is the seconds that Python takes to import SciPy, Numba and Dask.
"""

import atexit
import gc
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

# Modules that commands load before their first check.
IMPORTS = (
    "palpate.service.cli",
    "palpate.service.cluster.dask_cluster",
    "palpate.service.report.study.study_page",
    "palpate.service.run_study",
    "palpate.workers.blind.random_case",
    "palpate.workers.organs.breast.breast_organ",
    "palpate.workers.tasks.diagnosis_tasks",
    "palpate.workers.tasks.pipeline",
)


class ForkedCommands:
    """The command `palpate` of this source.

    Parameters
    ----------
    environment : mapping
        Environment of all commands.
    wrapped_in : sequence of str
        Prefix of the command that starts the parent process.
    """

    def __init__(self, environment: Mapping[str, str], wrapped_in: Sequence[str] = ()) -> None:
        self._server = subprocess.Popen(
            [*wrapped_in, sys.executable, "-P", __file__],
            env=dict(environment),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(
        self, arguments: Sequence[str], folder: Path, logs: Path, environment: Mapping[str, str]
    ) -> "subprocess.CompletedProcess[str]":
        """Run a command in a folder, with its streams in files in another one."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        streams = [str(logs / "stdout"), str(logs / "stderr")]
        asked = [list(arguments), str(folder), streams, dict(environment)]
        self._server.stdin.write(json.dumps(asked) + "\n")
        self._server.stdin.flush()
        code = int(self._server.stdout.readline())
        said = (Path(stream).read_text(errors="replace") for stream in streams)
        return subprocess.CompletedProcess(list(arguments), code, *said)

    def close(self) -> None:
        """End the parent process."""
        self._server.communicate()


@contextmanager
def forked_commands(
    environment: Mapping[str, str], wrapped_in: Sequence[str] = ()
) -> Iterator[ForkedCommands]:
    """Provide forked commands within the context."""
    commands = ForkedCommands(environment, wrapped_in)
    yield commands
    commands.close()


def main() -> None:
    """Run requests line by line and answer with exit codes."""
    for name in IMPORTS:
        importlib.import_module(name)
    from palpate.__main__ import main as palpate

    gc.freeze()
    for line in sys.stdin:
        arguments, folder, streams, environment = json.loads(line)
        child = os.fork()
        if child == 0:
            os.chdir(folder)
            os.environ.update(environment)
            for number, stream in enumerate(streams, start=1):
                opened = os.open(stream, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(opened, number)
                os.close(opened)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            code = palpate(arguments)
            atexit._run_exitfuncs()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)  # unloading so many modules takes longer than the command
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
