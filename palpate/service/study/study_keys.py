"""The study file: a case, a target, a score, a search and a seed.

Case, target and score are defined in `workers.common_keys`; this module adds the search, reads
YAML, and lists the keys in which two studies differ. A file that is read for its case alone needs
no target and no search.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal, Self, cast

from pydantic import Field, ModelWrapValidatorHandler, SerializeAsAny, create_model, model_validator

from palpate.service.search.genetic_search import SteadyGenetic
from palpate.service.search.least_squares_search import FittedNames
from palpate.service.search.search_interface import Search
from palpate.service.search.search_keys import (
    COARSE_LEVELS,
    LevelSpec,
    SearchRequest,
    SearchSpec,
    Strategy,
    strategy_named,
)
from palpate.service.search.stop_rules import StoppingSearch, StopRules
from palpate.storage.errors import InputError
from palpate.storage.json_digests import digest
from palpate.storage.values import FreeParameter, Prior
from palpate.workers.common_keys import (
    CaseSpec,
    Door,
    Identifiable,
    Name,
    Positive,
    ScoreSpec,
    TargetSpec,
    validated,
)
from palpate.workers.comparison.score_objective import Objective, objective_named
from palpate.workers.file_keys import missing_key
from palpate.workers.input_files import parse_yaml, read_text, reading
from palpate.workers.mechanics.model_parameters import unknown_name
from palpate.workers.organs.organ_plugins import DEFAULT, organ_names, organ_spec
from palpate.workers.organs.organ_protocol import no_derivatives

# Stands for a missing key.
ABSENT = "absent"


class StudySpec(Door):
    """A study: the body, its deformed image, and the search.

    Case, target and score are models of the organ that the case names; validating any study
    returns an instance of that organ's `study_of`. ``keep`` selects the deformed bodies that
    are stored in addition to the target and the best candidate. An evaluation that takes
    longer than ``deadline_s`` is retried once and then marked as failed; see
    `workers.tasks.evaluation_deadline`.

    Parameters
    ----------
    score
        How the deformed body is compared with the target.
    seed
        Seed of the search; the same seed gives the same candidates.
    keep
        Deformed bodies to store in addition to the target and the best candidate.
    deadline_s
        Longest time of one evaluation, in s. One that takes longer is retried once and then marked
        as failed. Default: no limit.
    """

    name: Name = Field(description="the study's folder is runs/NAME")
    case: SerializeAsAny[CaseSpec] = Field(description="the undeformed body, its model and load")
    target: SerializeAsAny[TargetSpec] = Field(description="the deformed body to be explained")
    score: SerializeAsAny[ScoreSpec] = ScoreSpec()
    search: SearchSpec = Field(description="the searched parameters and the strategy")
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
    keep: Literal["best", "elites", "all"] = "best"
    deadline_s: Positive | None = None

    @model_validator(mode="wrap")
    @classmethod
    def _with_the_doors_of_its_organ(
        cls, data: Any, handler: ModelWrapValidatorHandler[Self]
    ) -> Self:
        if cls is StudySpec and isinstance(data, Mapping):
            study: Any = study_of(organ_in(data)).model_validate(data)
            return cast(Self, study)
        return handler(data)

    @classmethod
    def record_for(cls, data: Any) -> type[Door]:
        """Return the study model of the organ named in `data`."""
        return study_of(organ_in(data)) if isinstance(data, Mapping) else cls

    @model_validator(mode="after")
    def _load_is_stated_for_an_image(self) -> Self:
        """Require the load of an image to be given: only the user knows it."""
        lacking = self.case.unstated_load(self.search.parameters)
        if self.target.is_image and lacking:
            raise missing_key(
                f"{lacking}: this key is missing: the load under which the target was imaged"
            )
        return self

    @model_validator(mode="after")
    def _parameters_fit_the_case(self) -> Self:
        self._refuse_unknown("search.parameters", self.search.parameters)
        self._refuse_unknown("target.constants", self.target.constants or {})
        try:
            self.case.parameters.bounds_from_door(self.search.parameters)
        except InputError as error:
            raise ValueError(f"search.parameters: {error}") from None
        for name in self.search.parameters:
            if name in self.case.constants:
                raise ValueError(
                    f"{name} is searched (search.parameters) and held (case.constants): "
                    "remove it from one of them"
                )
        return self

    def _refuse_unknown(self, where: str, names: Iterable[str]) -> None:
        known = self.case.parameters.door_names
        for name in names:
            if name not in known:
                unused = self.case.unused_parameter(name)
                reason = f" ({unused})" if unused else ""
                raise ValueError(f"{where}: {unknown_name('parameter', name, known)}{reason}")

    @model_validator(mode="after")
    def _organ_has_derivatives(self) -> Self:
        if self.search.by_derivatives and not organ_spec(self.case.organ).has_derivatives:
            reason = no_derivatives(self.case.organ)
            raise ValueError(f"search.strategy {self.search.strategy}: {reason}")
        return self

    @property
    def search_strategy(self) -> Search:
        """Return the search."""
        search, stop = self._strategy.make(self._asked), self.search.stop
        if stop is None:
            return search
        score = None if stop.score is None else self.objective.minimised(stop.score)
        goal = "" if stop.score is None else self.objective.text({self.objective.name: stop.score})
        return StoppingSearch(search, StopRules(score, stop.evaluations, goal))

    @property
    def steady_search(self) -> SteadyGenetic:
        """Return the steady search."""
        search = self.search
        in_flight = search.in_flight or search.population
        return SteadyGenetic(search.space, search.settings, self.seed, in_flight)

    @property
    def most_evaluations(self) -> int:
        """Return the number of evaluations if the search never stops early."""
        if self.search.steady:
            return self.search.population * self.search.generations
        most, stop = self._strategy.most_evaluations(self._asked), self.search.stop
        return most if stop is None or stop.evaluations is None else min(most, stop.evaluations)

    @property
    def most_generations(self) -> int:
        """Return the number of generations if the search never stops early."""
        return self._strategy.most_generations(self._asked)

    @property
    def levels(self) -> tuple[LevelSpec, ...]:
        """Return the coarser resolutions in which constants are fitted first, coarse to fine.

        Without ``search.levels`` a fit from scratch uses the `COARSE_LEVELS` that have at
        most half the nodes of the case.
        """
        if self.search.levels is not None:
            return self.search.levels
        nodes = self.case.mesh_nodes
        if not self._strategy.coarse_first or nodes is None:
            return ()
        return tuple(level for level in COARSE_LEVELS if 2 * level.nodes <= nodes)

    @property
    def free_parameters(self) -> list[FreeParameter]:
        """Return the searched parameters with internal names and units, for an evaluation."""
        bounds, priors = self.case.parameters.bounds_from_door(self.search.parameters), self.priors
        free: list[FreeParameter] = []
        for name, (lower, upper) in bounds.items():
            free.append({"name": name, "lower": lower, "upper": upper})
            if name in priors:
                free[-1]["prior"] = priors[name]
        return free

    @property
    def priors(self) -> dict[str, Prior]:
        """Return mean and standard deviation of parameters with a prior, in internal units."""
        priors: dict[str, Prior] = {}
        for name, (mean, sd) in self.search.priors.items():
            parameter = self.case.parameters.at_door(name)
            per_inside = float(parameter.unit.to_door(1.0))
            priors[parameter.name] = mean / per_inside, sd / per_inside
        return priors

    @property
    def fitted_names(self) -> FittedNames:
        """Return the names and units of the genes in an evaluation's least-squares problem."""
        genes = [self.case.parameters.at_door(name) for name in self.search.parameters]
        return FittedNames(tuple(p.name for p in genes), tuple(p.unit.to_door(1.0) for p in genes))

    @property
    def _strategy(self) -> Strategy:
        return strategy_named(self.search.strategy)

    @property
    def _asked(self) -> SearchRequest:
        return SearchRequest(self.search, self.fitted_names, len(self.levels), self.seed)

    @property
    def common_scale(self) -> tuple[str, ...]:
        """Return the searched stiffnesses known only up to a common factor, by internal name."""
        names = [self.case.parameters.at_door(name).name for name in self.search.parameters]
        return self.case.common_scale(names)

    def constants_of(self, genes: Mapping[str, float]) -> dict[str, float]:
        """Convert searched parameters to internal names and units (kPa to MPa)."""
        return self.case.parameters.from_door(genes)

    @property
    def identifiable(self) -> Identifiable:
        """Return the identifiability of the stiffnesses: values, or only their ratios."""
        parameters = self.case.parameters
        return self.case.identifiable(
            {parameters.at_door(name).name for name in self.search.parameters}
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, including defaults, except keys that older studies lack."""
        values = self.model_dump(mode="json")
        if self.deadline_s is None:
            del values["deadline_s"]
        if values["target"].get("align") is None:
            values["target"].pop("align", None)
        return values

    @property
    def objective(self) -> Objective:
        """Return the score that the search optimises."""
        return objective_named(self.score.objective)

    def __repr__(self) -> str:
        names = list(self.search.parameters)
        shown = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
        return f"<Study file {self.name}: {self.case.organ}, {shown} by {self.search.strategy}>"

    @property
    def digest(self) -> str:
        """Return the digest of the study file's content."""
        return digest(self.as_dict())


@cache
def study_of(organ: str) -> type[StudySpec]:
    """Return the study model with the case, target and score of an organ.

    Raises
    ------
    InputError
        If the organ is unknown.
    """
    doors = organ_spec(organ)
    made: type[StudySpec] = create_model(
        f"{organ.capitalize()}Study",
        __base__=StudySpec,
        case=(doors.case, StudySpec.model_fields["case"]),
        target=(doors.target, StudySpec.model_fields["target"]),
        score=(doors.score, doors.score()),
    )
    return made


def organ_in(data: Mapping[str, Any]) -> str:
    """Return the organ named in a study; the default if it is invalid."""
    case = data.get("case")
    named = case.get("organ", DEFAULT) if isinstance(case, Mapping) else DEFAULT
    organ = getattr(case, "organ", named)
    return organ if isinstance(organ, str) and organ in organ_names() else DEFAULT


def read_spec(path: Path) -> StudySpec:
    """Read a study file.

    Paths of volumes are relative to the folder of the file and are made absolute, so a study
    can be continued from any folder.

    Raises
    ------
    InputError
        If the file does not exist, is not YAML, or has an invalid key or value.
    """
    return parse_spec(study_text(path), str(path), path.resolve().parent)


def study_text(path: Path) -> str:
    """Return the text of a study file.

    Raises
    ------
    InputError
        If the file does not exist, or is not text.
    """
    if path.is_dir():
        raise InputError(
            f"{path} is a folder; expected a study file such as {path / 'study.yaml'}."
        )
    try:
        return read_text(path)
    except FileNotFoundError:
        raise InputError(
            f"There is no study file {path}. Write one with `palpate new breast "
            f"{quote(path.stem)}`."
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as text: {error}.") from error


def parse_spec(text: str, where: str, folder: Path) -> StudySpec:
    """Parse the study in `text`; `where` names it in messages.

    Raises
    ------
    InputError
        If it is not YAML, or has an invalid key or value.
    """
    with reading(where, "a study"):
        return spec_from_keys(parse_yaml(text, where), where, folder, text)


def spec_from_keys(data: Any, where: str, folder: Path, text: str = "") -> StudySpec:
    """Validate the keys of a study, read from `text` if that is given; they may be modified.

    Raises
    ------
    InputError
        If there are no keys, or one is invalid.
    """
    with reading(where, "a study"):
        return validated(StudySpec, _with_absolute_paths(data, where, folder), where, text)


def study_keys(text: str, where: str, folder: Path) -> dict[str, Any]:
    """Return the keys of a study as written, with absolute paths of volumes.

    Raises
    ------
    InputError
        If the text is not YAML, or has no keys.
    """
    return _with_absolute_paths(parse_yaml(text, where), where, folder)


def _with_absolute_paths(data: Any, where: str, folder: Path) -> dict[str, Any]:
    if not isinstance(data, dict):
        kind = "nothing" if data is None else type(data).__name__
        raise InputError(f"{where} must have keys such as name, case and search, found {kind}.")
    _make_absolute(data.get("target"), folder)
    case = data.get("case")
    _make_absolute(case.get("reference") if isinstance(case, dict) else None, folder)
    return data


def _make_absolute(image: object, folder: Path) -> None:
    """Make paths that exist next to the study file absolute; names in the store are kept."""
    for key, value in image.items() if isinstance(image, dict) else ():
        _make_absolute(value, folder)
        if key in ("volume", "file", "labels") and isinstance(value, str):
            beside = (folder / Path(value).expanduser()).resolve()
            if isinstance(image, dict) and beside.exists():
                image[key] = str(beside)


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the keys in which two studies differ, one line each.

    Examples
    --------
    >>> differences({"seed": 1, "search": {"elite": 2}}, {"seed": 1, "search": {"elite": 3}})
    ['search.elite: 2 before, 3 now']
    """
    return [
        f"{key}: {old} before, {new} now"
        for key, (old, new) in differing_settings([before, now]).items()
    ]


def differing_settings(studies: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Return the keys in which studies differ, each with its value in every study.

    Examples
    --------
    >>> differing_settings([{"seed": 1, "a": {"b": 2}}, {"seed": 1, "a": {"b": 3}}, {"seed": 1}])
    {'a.b': (2, 3, 'absent')}
    """
    each = [dict(_leaves(study)) for study in studies]
    keys = dict.fromkeys(key for one in each for key in one)
    values = {key: tuple(one.get(key, ABSENT) for one in each) for key in keys}
    return {key: found for key, found in values.items() if any(v != found[0] for v in found)}


def _leaves(value: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, item in value.items():
        if isinstance(item, Mapping) and item:
            yield from _leaves(item, f"{path}{key}.")
        else:
            yield f"{path}{key}", item


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
            spec = validated(StudySpec, data, where, text)
            return NamedCase(spec.name, spec.case)
        for key in data:
            if key not in StudySpec.model_fields:
                raise InputError(
                    f"{where}: {unknown_name('key', str(key), StudySpec.model_fields)}"
                )
        stated = {key: data[key] for key in ("name", "case") if key in data}
        named_case: Any = validated(_named_case_of(organ_in(data)), stated, where, text)
        return NamedCase(named_case.name or path.stem, named_case.case)


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
