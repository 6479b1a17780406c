"""Commands are listed without importing them."""

import inspect
import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from palpate.service.cli import COMMANDS


def complete(words: str) -> list[str]:
    """Return the bash completions after some words."""
    environment = os.environ | {
        "_PALPATE_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(words.count(" ")),
    }
    done = subprocess.run(
        [sys.executable, "-c", "from palpate.service.cli import main; main()"],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    return done.stdout.split()


@pytest.mark.parametrize("name", COMMANDS)
def test_the_summary_is_the_first_sentence_of_the_help(name: str) -> None:
    command = COMMANDS[name].load(name)
    first = inspect.cleandoc(command.help).split("\n\n")[0]
    assert COMMANDS[name].summary == " ".join(first.split())


def test_listing_imports_no_command() -> None:
    code = (
        "import sys\n"
        "from palpate.service.cli import main\n"
        "assert main(['--help']) == 0\n"
        "places = ('images', 'machines', 'studies', 'validation')\n"
        "names = {f'palpate.service.commands.{place}' for place in places}\n"
        "sys.exit(str(sorted(names & set(sys.modules)) or '') or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name, command in COMMANDS.items():
        assert f"  {name} " in done.stdout
        assert command.summary in done.stdout


@pytest.mark.parametrize("organ", ["breast", "cornea"])
def test_reading_study_does_not_import_solver(organ: str) -> None:
    code = (
        "import sys\n"
        "import palpate.service.commands.studies.status\n"
        "from palpate.service.study.study_keys import study_of\n"
        f"study_of({organ!r})\n"
        "names = {'scipy', 'numba', 'nibabel', 'pydicom', 'matplotlib', 'distributed'}\n"
        "sys.exit(str(sorted(names & set(sys.modules)) or '') or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_misspelt_command_is_suggested(call: Callable[..., tuple[int, str, str]]) -> None:
    code, _, err = call("statsu")
    assert code == 2
    assert "Did you mean 'status'" in err


def test_completes_commands_subcommands_and_options() -> None:
    assert complete("palpate st") == ["status", "strategies", "store"]
    assert complete("palpate token ") == ["new", "list", "remove"]
    assert "--out" in complete("palpate new --")
