"""Keys, region and server from the files of the AWS command line.

::

    AWS_PROFILE                    the profile; "default" if unset
    AWS_SHARED_CREDENTIALS_FILE    ~/.aws/credentials: its keys
    AWS_CONFIG_FILE                ~/.aws/config: its region and endpoint_url, or its keys

Only keys in these files are used. A profile that gets its keys elsewhere (single sign-on, a
role, a program) is refused, with the command that exports them to the environment.
"""

import configparser
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from palpate.storage.errors import StoreError

DEFAULT = "default"
# Options of a profile that gets its keys elsewhere.
_ELSEWHERE = (
    "sso_session",
    "sso_start_url",
    "role_arn",
    "credential_process",
    "login_session",
    "web_identity_token_file",
)

_Sections = dict[str, Mapping[str, str]]


@dataclass(frozen=True)
class Profile:
    """Values of a profile; an empty string for a missing one."""

    access_key_id: str = ""
    secret_access_key: str = ""
    session_token: str = ""
    region: str = ""
    endpoint_url: str = ""


def read_profile() -> Profile:
    """Return the profile selected by the environment.

    Raises
    ------
    StoreError
        If AWS_PROFILE names no profile, a file cannot be read, or the keys are not in the files.
    """
    named = os.environ.get("AWS_PROFILE", "")
    name = named or DEFAULT
    credentials = _file("AWS_SHARED_CREDENTIALS_FILE", "credentials")
    config = _file("AWS_CONFIG_FILE", "config")
    keys = _sections(credentials)
    settings = {_plain(section): values for section, values in _sections(config).items()}
    if named and name not in keys and name not in settings:
        known = ", ".join(sorted({*keys, *settings})) or "none"
        raise StoreError(
            f"There is no profile {name} in {credentials} or {config}; profiles there: {known}. "
            "Set AWS_PROFILE to one of them, or unset it and set AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY."
        )
    values = {**settings.get(name, {}), **keys.get(name, {})}
    access, secret = values.get("aws_access_key_id", ""), values.get("aws_secret_access_key", "")
    if bool(access) != bool(secret):
        raise StoreError(
            f"The profile {name} in {credentials} or {config} has only half a key pair: it needs "
            "both aws_access_key_id and aws_secret_access_key."
        )
    elsewhere = next((key for key in _ELSEWHERE if key in values), "")
    if elsewhere and not access:
        raise StoreError(
            f"The profile {name} in {config} gets its keys from {elsewhere}, which is not "
            f'supported. Run: eval "$(aws configure export-credentials --profile {name} --format '
            'env)", here and on the workers.'
        )
    return Profile(
        access,
        secret,
        values.get("aws_session_token", ""),
        values.get("region", ""),
        values.get("endpoint_url", ""),
    )


def _file(variable: str, name: str) -> Path:
    given = os.environ.get(variable)
    return Path(given or Path("~/.aws") / name).expanduser()


def _plain(section: str) -> str:
    """Return the profile name in a heading of the config file: ``[profile NAME]``."""
    return section.removeprefix("profile ").strip()


def _sections(path: Path) -> _Sections:
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return {}
    return _parsed(path, changed)


@lru_cache(maxsize=16)
def _parsed(path: Path, changed: int) -> _Sections:
    parser = configparser.RawConfigParser(strict=False, default_section="")
    try:
        parser.read_string(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, configparser.Error) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(
            f"{path} cannot be read: {reason}. Fix it, or set AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY, which replace it."
        ) from error
    return {section: dict(parser[section]) for section in parser.sections()}
