"""Verbosity options: -q, -v and --log-level."""

import logging
from collections.abc import Callable, Iterator

import pytest

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture(autouse=True)
def restored_logger() -> Iterator[None]:
    logger = logging.getLogger("palpate")
    handlers, level = logger.handlers, logger.level
    yield
    logger.handlers = handlers
    logger.setLevel(level)


@pytest.mark.parametrize(
    ("options", "levels"),
    [
        ([], []),
        (["-v"], ["INFO"]),
        (["--log-level", "debug"], ["DEBUG", "INFO"]),
        (["-v", "--log-level", "error"], []),
    ],
)
def test_shows_log_messages_from_level(
    call: Call, capsys: pytest.CaptureFixture[str], options: list[str], levels: list[str]
) -> None:
    assert call(*options, "parameters", "--json")[0] == 0
    log = logging.getLogger("palpate.service.example")
    log.debug("a detail")
    log.info("a step")
    said = capsys.readouterr().err
    assert [level for level in ("DEBUG", "INFO") if level in said] == levels


def test_an_unknown_level_is_refused(call: Call) -> None:
    code, _, err = call("--log-level", "loud", "parameters")
    assert code == 2
    assert "loud" in err
