"""Connections to an object store: credentials, retries and readable errors.

Address and credentials come from the environment variables that every client reads::

    AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN
    AWS_REGION or AWS_DEFAULT_REGION
    AWS_ENDPOINT_URL              of a server other than Amazon's, http:// or https://

    GOOGLE_APPLICATION_CREDENTIALS, or else `gcloud auth application-default login`
    GOOGLE_BASE_URL

    AZURE_STORAGE_ACCOUNT_NAME, AZURE_STORAGE_ACCOUNT_KEY or AZURE_STORAGE_SAS_TOKEN
    AZURE_STORAGE_ENDPOINT

Without AWS_ACCESS_KEY_ID, keys, region and server for S3 come from the files of the AWS command
line::

    AWS_PROFILE                    the profile; "default" if unset
    AWS_SHARED_CREDENTIALS_FILE    ~/.aws/credentials: its keys
    AWS_CONFIG_FILE                ~/.aws/config: its region and endpoint_url, or its keys

Only keys in these files are used. A profile that gets its keys elsewhere (single sign-on, a
role, a program) is refused, with the command that exports them to the environment. Credentials
for Google and Azure are read by obstore.

A request that reaches no server, or a failing one, is retried after growing pauses. The first
request of a process gives up sooner: a wrong address is more likely than an outage.
"""

import configparser
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.storage.backends.store_paths import ObjectPath, Scheme
from palpate.storage.errors import StoreError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

DEFAULT_PROFILE = "default"
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
class AwsProfile:
    """Values of a profile; an empty string for a missing one."""

    access_key_id: str = ""
    secret_access_key: str = ""
    session_token: str = ""
    region: str = ""
    endpoint_url: str = ""


def read_aws_profile() -> AwsProfile:
    """Return the profile selected by the environment.

    Raises
    ------
    StoreError
        If AWS_PROFILE names no profile, a file cannot be read, or the keys are not in the files.
    """
    named = os.environ.get("AWS_PROFILE", "")
    name = named or DEFAULT_PROFILE
    credentials = _profile_file("AWS_SHARED_CREDENTIALS_FILE", "credentials")
    config = _profile_file("AWS_CONFIG_FILE", "config")
    keys = _sections(credentials)
    settings = {_plain_key(section): values for section, values in _sections(config).items()}
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
    return AwsProfile(
        access,
        secret,
        values.get("aws_session_token", ""),
        values.get("region", ""),
        values.get("endpoint_url", ""),
    )


def _profile_file(variable: str, name: str) -> Path:
    given = os.environ.get(variable)
    return Path(given or Path("~/.aws") / name).expanduser()


def _plain_key(section: str) -> str:
    """Return the profile name in a heading of the config file: ``[profile NAME]``."""
    return section.removeprefix("profile ").strip()


def _sections(path: Path) -> _Sections:
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return {}
    return _parsed_profiles(path, changed)


@lru_cache(maxsize=16)
def _parsed_profiles(path: Path, changed: int) -> _Sections:
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


FIRST_PATIENCE_S = 20.0
PATIENCE_S = 300.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 3.0
CONNECT_S, REQUEST_S = 5.0, 60.0
MOST_RETRIES = 100_000  # in practice the patience ends first


@dataclass(frozen=True)
class _Service:
    """An object store service.

    Parameters
    ----------
    store : str
        Class of obstore.
    name : str
    variables : str
        Prefix of the environment variables that obstore reads itself; empty for none.
    endpoint : str
        Variable with the address of another server, for messages.
    endpoints : tuple of str
        All such variables; the first one that is set is used.
    without_keys : str
        Advice if there are no credentials.
    keys : str
        Variables to check if access is refused.
    """

    store: str
    name: str
    variables: str
    endpoint: str
    endpoints: tuple[str, ...]
    without_keys: str
    keys: str


_SERVICES: dict[Scheme, _Service] = {
    "s3": _Service(
        store="S3Store",
        name="Amazon S3",
        variables="",
        endpoint="AWS_ENDPOINT_URL",
        endpoints=("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"),
        without_keys="Set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or write them to "
        "~/.aws/credentials with `aws configure`",
        keys="AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY or the profile (AWS_PROFILE)",
    ),
    "gs": _Service(
        store="GCSStore",
        name="Google Cloud Storage",
        variables="GOOGLE_",
        endpoint="GOOGLE_BASE_URL",
        endpoints=("GOOGLE_BASE_URL",),
        without_keys="Set GOOGLE_APPLICATION_CREDENTIALS to a file of credentials, or run `gcloud "
        "auth application-default login`",
        keys="GOOGLE_APPLICATION_CREDENTIALS",
    ),
    "az": _Service(
        store="AzureStore",
        name="Azure Blob Storage",
        variables="AZURE_",
        endpoint="AZURE_STORAGE_ENDPOINT",
        endpoints=("AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT"),
        without_keys="Set AZURE_STORAGE_ACCOUNT_NAME, and AZURE_STORAGE_ACCOUNT_KEY or "
        "AZURE_STORAGE_SAS_TOKEN",
        keys="AZURE_STORAGE_ACCOUNT_NAME, AZURE_STORAGE_ACCOUNT_KEY or AZURE_STORAGE_SAS_TOKEN",
    ),
}
_WHO = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
_REGIONS = ("AWS_REGION", "AWS_DEFAULT_REGION")
REGION = "us-east-1"

_reached: set[tuple[Scheme, str]] = set()
"""Buckets that have responded to this process."""


def client_of(place: ObjectPath) -> "ObjectStore":
    """Return the connection to a bucket, cached for each environment.

    Raises
    ------
    StoreError
        If obstore is not installed, or the credentials cannot be used.
    """
    reached = (place.scheme, place.bucket) in _reached
    begins = _SERVICES[place.scheme].variables
    read = {n: v for n, v in os.environ.items() if n in _WHO or (begins and n.startswith(begins))}
    options = _s3_options() if place.scheme == "s3" else {}
    return _client(
        replace(place, key=""),
        tuple(sorted(options.items())),
        tuple(sorted(read.items())),
        _server_url(place.scheme),
        PATIENCE_S if reached else FIRST_PATIENCE_S,
    )


def _server_url(scheme: Scheme) -> str:
    """Return the address of a server other than the provider's own; else empty."""
    if scheme == "s3":
        return _access().endpoint_url
    return _stated(_SERVICES[scheme].endpoints)


def _s3_options() -> dict[str, str]:
    access = _access()
    said = {
        "region": access.region,
        "endpoint": access.endpoint_url,
        "access_key_id": access.access_key_id,
        "secret_access_key": access.secret_access_key,
        "session_token": access.session_token,
    }
    return {name: value for name, value in said.items() if value}


def _access() -> AwsProfile:
    """Return the settings from the environment, with keys from a profile if it has none.

    Raises
    ------
    StoreError
        If the profile cannot be used.
    """
    profile = AwsProfile() if os.environ.get("AWS_ACCESS_KEY_ID") else read_aws_profile()
    return replace(
        profile,
        region=_stated(_REGIONS) or profile.region or REGION,
        endpoint_url=_stated(_SERVICES["s3"].endpoints) or profile.endpoint_url,
    )


def _stated(names: tuple[str, ...]) -> str:
    return next((os.environ[name] for name in names if os.environ.get(name)), "")


@contextmanager
def explained(place: ObjectPath) -> Iterator[None]:
    """Turn errors from a request into a `StoreError` with advice.

    Raises
    ------
    FileNotFoundError
        If the object does not exist.
    """
    from obstore.exceptions import BaseError

    try:
        yield
    except FileNotFoundError as error:
        if _is_no_bucket(str(error)):
            raise _no_bucket(place) from error
        raise
    except BaseError as error:
        raise _explanation(place, error) from error
    _reached.add((place.scheme, place.bucket))


@lru_cache(maxsize=16)
def _client(
    bucket: ObjectPath,
    options: tuple[tuple[str, str], ...],
    read: tuple[tuple[str, str], ...],
    server_url: str,
    patience_s: float,
) -> "ObjectStore":
    """Connect to a bucket; `read` lists the variables that obstore reads itself."""
    try:
        from obstore import store
    except ImportError as error:
        raise StoreError(
            f"{bucket} is an object store, which needs obstore. Install it on every machine with "
            "`pip install 'palpate[cloud]'`, or give a local folder."
        ) from error
    from obstore.exceptions import BaseError

    connect: Any = getattr(store, _SERVICES[bucket.scheme].store)
    try:
        made: ObjectStore = connect(
            bucket.bucket,
            config=dict(options),
            client_options={
                "allow_http": server_url.startswith("http://"),
                "connect_timeout": timedelta(seconds=CONNECT_S),
                "timeout": timedelta(seconds=REQUEST_S),
            },
            retry_config={
                "max_retries": MOST_RETRIES,
                "retry_timeout": timedelta(seconds=patience_s),
                "backoff": {
                    "init_backoff": timedelta(seconds=FIRST_PAUSE_S),
                    "max_backoff": timedelta(seconds=LONGEST_PAUSE_S),
                    "base": 2,
                },
            },
        )
    except BaseError as error:
        raise StoreError(
            f"{bucket} cannot be used: {_first(str(error))}. "
            f"{_SERVICES[bucket.scheme].without_keys}, here and on the workers."
        ) from error
    return made


def _no_bucket(place: ObjectPath) -> StoreError:
    return StoreError(
        f"There is no bucket {place.bucket} at {_server(place)}. Create it, or check its name and "
        f"{_SERVICES[place.scheme].endpoint}."
    )


def _is_no_bucket(text: str) -> bool:
    return any(code in text for code in ("NoSuchBucket", "ContainerNotFound"))


def _explanation(place: ObjectPath, error: Exception) -> StoreError:
    from obstore.exceptions import PermissionDeniedError, UnauthenticatedError

    text, service = str(error), _SERVICES[place.scheme]
    if _is_no_bucket(text):
        return _no_bucket(place)
    if "169.254." in text:  # where machines of the provider request credentials
        return StoreError(
            f"{place} cannot be used: there are no credentials. {service.without_keys}, here and "
            "on the workers."
        )
    if isinstance(error, PermissionDeniedError | UnauthenticatedError):
        return StoreError(
            f"{place} cannot be used: {_server(place)} denies access{_code(text)}. Check "
            f"{service.keys}, and their permissions for this bucket."
        )
    if _is_unreached(text):
        return StoreError(
            f"{place} cannot be reached at {_server(place)}{_tried(text)}. Check "
            f"{service.endpoint} and the network. Stored results are kept: run the command "
            "again to continue."
        )
    return StoreError(f"{place} cannot be used: {_first(text)}. Check the server and its log.")


def was_cut_off(error: Exception) -> bool:
    """Return True if a request got no response and was not retried."""
    return _is_unreached(str(error)) and not _tried(str(error))


def _is_unreached(text: str) -> bool:
    return "HTTP error" in text or "error sending request" in text


def _server(place: ObjectPath) -> str:
    return _server_url(place.scheme) or _SERVICES[place.scheme].name


def _code(text: str) -> str:
    """Return the server's error code, such as (InvalidAccessKeyId)."""
    _, found, rest = text.partition("<Code>")
    return f" ({rest.partition('</Code>')[0]})" if found else ""


def _tried(text: str) -> str:
    """Return the number and duration of attempts, from obstore's message."""
    tried = re.search(r" in (?P<seconds>[\d.]+)s, after (?P<retries>\d+) retries", text)
    if tried is None:
        return ""
    return f", tried {int(tried['retries']) + 1} times in {float(tried['seconds']):.0f} s"


def _first(text: str) -> str:
    """Return the first line of an error; obstore's further lines are for its developers."""
    return text.partition("\n")[0].strip().rstrip(".")
