"""The case of a study file; a target and a search are optional."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field, create_model

from palpate.service.study.spec import StudySpec, organ_in, study_keys, study_text
from palpate.storage.errors import InputError
from palpate.workers.input_files import reading
from palpate.workers.mechanics.parameters import unknown_name
from palpate.workers.organs.registry import organ_spec
from palpate.workers.spec import CaseSpec, Door, validated

SEARCHED = {"target", "search"}


@dataclass(frozen=True)
class NamedCase:
    """A case and the name of its file or study.

    Parameters
    ----------
    name : str
    case : CaseSpec
    """

    name: str
    case: CaseSpec


def read_case(path: Path) -> NamedCase:
    """Read the case from a file; one with a target and a search is checked as a whole study.

    Raises
    ------
    InputError
        If the file does not exist, is not YAML, or has an invalid key or value.
    """
    where, text = str(path), study_text(path)
    with reading(where, "a study"):
        data = study_keys(text, where, path.resolve().parent)
        if data.keys() >= SEARCHED:
            spec = validated(StudySpec, data, where)
            return NamedCase(spec.name, spec.case)
        for key in data:
            if key not in StudySpec.model_fields:
                raise InputError(
                    f"{where}: {unknown_name('key', str(key), StudySpec.model_fields)}"
                )
        stated = {key: data[key] for key in ("name", "case") if key in data}
        found: Any = validated(_named_case_of(organ_in(data)), stated, where)
        return NamedCase(found.name or path.stem, found.case)


@cache
def _named_case_of(organ: str) -> type[Door]:
    """Return a model whose keys are a name and the case of an organ."""
    case = StudySpec.model_fields["case"].description
    return create_model(
        f"{organ.capitalize()}CaseFile",
        __base__=Door,
        name=(str | None, None),
        case=(organ_spec(organ).case, Field(description=case)),
    )
