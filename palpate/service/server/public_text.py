"""Messages for clients, without server paths and tracebacks."""

import re

_TRACEBACK = re.compile(r"\s*Traceback \(most recent call last\):.*", re.DOTALL)
_PATH = re.compile(r"(?<![\w:/.])/(?:[^\s:'\",;()\[\]<>]+/)*([^\s:'\",;()\[\]<>/]*)")
MOST = 2000


def public(text: str) -> str:
    r"""Return a message without tracebacks and with absolute paths cut to their last name.

    Examples
    --------
    >>> public("/srv/palpate/runs/.service/uploads/a/scan.nrrd is cut short.")
    'scan.nrrd is cut short.'
    >>> public("A task crashed: ValueError\nTraceback (most recent call last):\n  File ...")
    'A task crashed: ValueError'
    >>> public("GET /api/v1/jobs lists all; see http://localhost:8780/x.")
    'GET /api/v1/jobs lists all; see http://localhost:8780/x.'
    """
    shown = _PATH.sub(_last_name, _TRACEBACK.sub("", text))
    return shown if len(shown) <= MOST else f"{shown[:MOST]} ..."


def _last_name(match: re.Match[str]) -> str:
    return match[0] if match[0].startswith("/api/") or len(match[0]) < 2 else match[1] or "/"
