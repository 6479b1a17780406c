"""Keys of an object store from the files of the AWS command line."""

import os
from pathlib import Path

import pytest

from palpate.storage.backends.bucket_client import AwsProfile, read_aws_profile
from palpate.storage.errors import StoreError

CREDENTIALS = """\
[default]
aws_access_key_id = one
aws_secret_access_key = a%b/c=
[lab]
aws_access_key_id = two
aws_secret_access_key = secret
aws_session_token = token
[half]
aws_access_key_id = three
"""
CONFIG = """\
[default]
region = eu-central-1
[profile lab]
region = eu-west-1
endpoint_url = http://objects:9000
s3 =
  addressing_style = path
[profile signed-on]
sso_session = lab
[profile bare]
region = eu-north-1
"""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Home folder with both files, and an environment without AWS variables."""
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".aws").mkdir()
    (tmp_path / ".aws" / "credentials").write_text(CREDENTIALS)
    (tmp_path / ".aws" / "config").write_text(CONFIG)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "profile"),
    [
        ("", AwsProfile("one", "a%b/c=", "", "eu-central-1")),
        ("default", AwsProfile("one", "a%b/c=", "", "eu-central-1")),
        ("lab", AwsProfile("two", "secret", "token", "eu-west-1", "http://objects:9000")),
        ("bare", AwsProfile(region="eu-north-1")),
    ],
)
def test_profile_is_read_from_both_files(
    home: Path, monkeypatch: pytest.MonkeyPatch, name: str, profile: AwsProfile
) -> None:
    monkeypatch.setenv("AWS_PROFILE", name)
    assert read_aws_profile() == profile


def test_files_at_other_paths_are_read_again_when_changed(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = home / "keys"
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(other))
    monkeypatch.setenv("AWS_CONFIG_FILE", "~/nothing-there")
    assert read_aws_profile() == AwsProfile()
    for key in ("first", "second"):
        other.write_text(f"[default]\naws_access_key_id={key}\naws_secret_access_key=x\n")
        os.utime(other, (1, len(key)))
        assert read_aws_profile() == AwsProfile(key, "x")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lob", "no profile lob in .*profiles there: bare, default, half, lab, signed-on"),
        ("half", "has only half a key pair"),
        ("signed-on", "from sso_session, .* export-credentials --profile signed-on --format env"),
    ],
)
def test_refuses_unusable_profile(
    home: Path, monkeypatch: pytest.MonkeyPatch, name: str, message: str
) -> None:
    monkeypatch.setenv("AWS_PROFILE", name)
    with pytest.raises(StoreError, match=message):
        read_aws_profile()


def test_unreadable_file_is_named(home: Path) -> None:
    (home / ".aws" / "config").write_text("region = eu\n")
    with pytest.raises(StoreError, match=r"config cannot be read: .*Fix it, or set AWS_ACCESS_KEY"):
        read_aws_profile()
