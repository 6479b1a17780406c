"""A solved breast, shared by the tests of this folder."""

import pytest

from palpate.service.export.solved_mesh_files import SolvedBody, solve_body
from tests.service.export.small_breast import CASE, CONSTANTS


@pytest.fixture(scope="package")
def store(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="package")
def body(store: str) -> SolvedBody:
    return solve_body(CASE, CONSTANTS, store, "a small breast")
