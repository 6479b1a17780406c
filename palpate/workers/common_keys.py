"""Keys of a study that are common to all organs, and their validation.

The unit is part of every key. An unknown key is refused with a suggestion; `explain`
converts pydantic's errors to a message for the user, and `validated` raises it as an
`InputError`. The keys of one organ are in its own ``NAME_keys.py``.
"""

import math
import re
import reprlib
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, reduce
from operator import getitem
from typing import Annotated, Any, ClassVar, Literal, LiteralString, Self, TypeVar
from unicodedata import normalize

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    StringConstraints,
    ValidationError,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from palpate.storage.errors import InputError
from palpate.storage.read_only import hold_read_only, read_only
from palpate.workers.file_keys import (
    Pairs,
    errors_with_pairs,
    is_missing,
    missing_key,
    missing_pairs,
    missing_text,
    one_of,
    without_empty_keys,
)
from palpate.workers.input_files import StrictLoader
from palpate.workers.mechanics.model_parameters import Vocabulary, unknown_name
from palpate.workers.plugins import Group, plugin
from palpate.workers.yaml_scalars import WrittenValues, is_text_in_older_yaml, number_to_write


def checked(check: Callable[[Any], object]) -> AfterValidator:
    """Return a validator that reports errors raised by `check` with the path of the key."""

    def validate(given: Any) -> Any:
        try:
            check(given)
        except InputError as error:
            raise ValueError(str(error)) from None
        return given

    return AfterValidator(validate)


def checked_name(group: Group, name: str) -> str:
    """Return the name of a known plug-in, or else raise a validation error."""
    try:
        return plugin(group, name).name
    except InputError as error:
        raise ValueError(str(error)) from None


DEFAULT_OBJECTIVE = "gsf"
Identifiable = Literal["absolute", "ratio"]
Misread = tuple[tuple[int | str, ...], Any, LiteralString]
"""Path, value and what was expected instead."""
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
# Names of studies and of stored images, which become file names.
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
Name = Annotated[str, StringConstraints(pattern=NAME_PATTERN)]
LawName = Annotated[str, AfterValidator(lambda name: checked_name("laws", name))]


LARGEST_NUMBER = 1e30
"""Largest number in any unit. The square of a force of 1e300 N is infinite."""


def _misread(given: Any, value: Any, path: tuple[int | str, ...] = ()) -> Iterator[Misread]:
    """Yield what pydantic has read as another kind of value: true as 1, yes as true."""
    if isinstance(value, bool) and not isinstance(given, bool):
        yield path, given, "expected true or false"
    elif isinstance(given, bool) and not isinstance(value, bool):
        yield path, given, "expected a number or a text, not true or false"
    elif isinstance(value, float) and math.isfinite(value) and abs(value) > LARGEST_NUMBER:
        yield path, given, "expected a number of at most 1e30"
    elif isinstance(given, Mapping) and isinstance(value, Mapping) and len(given) == len(value):
        for key, read, part in zip(given, value, value.values(), strict=True):
            if isinstance(key, bool):
                yield (*path, str(read)), key, "expected a number or a text as key"
            yield from _misread(given[key], part, (*path, str(key)))
    elif isinstance(given, list | tuple) and isinstance(value, list | tuple):
        for number, (item, part) in enumerate(zip(given, value, strict=False)):
            yield from _misread(item, part, (*path, number))


class FrozenModel(BaseModel):
    """Frozen record whose mappings and lists cannot be changed either.

    What follows from its values is computed once where that is slow, as a `cached_property`.
    """

    model_config = ConfigDict(frozen=True)

    @model_validator(mode="after")
    def _mappings_are_read_only(self) -> Self:
        hold_read_only(self)
        return self

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, which are not validated."""
        changed = None if update is None else read_only(dict(update))
        copied = super().model_copy(update=changed, deep=deep)
        for derived in vars(copied).keys() - type(self).model_fields.keys():
            del vars(copied)[derived]
        return copied


class Door(FrozenModel):
    """Frozen record that refuses unknown keys; an empty key counts as missing.

    Exactly one key of each group in `exactly_one` must be given. The
    `later_keys` are newer than some stored studies: they are omitted at their default values, so
    that the digests of those studies stay the same.
    """

    model_config = ConfigDict(extra="forbid")
    exactly_one: ClassVar[Pairs] = ()
    later_keys: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _without_later_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = handler(self)
        fields = type(self).model_fields
        for key in self.later_keys:
            if getattr(self, key) == fields[key].get_default(call_default_factory=True):
                values.pop(key, None)
        return values

    @model_validator(mode="before")
    @classmethod
    def _known_keys_only(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            unknown = [str(key) for key in data if key not in cls.model_fields]
            if unknown:
                raise ValueError(
                    "; ".join(unknown_name("key", k, cls.model_fields) for k in unknown)
                )
            return without_empty_keys(cls, data)
        return data

    @field_validator("*", mode="wrap")
    @classmethod
    def _no_other_kind(cls, given: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        value = handler(given)
        problems = [
            InitErrorDetails(type=PydanticCustomError("misread", text), loc=path, input=item)
            for path, item, text in _misread(given, value)
        ]
        if problems:
            raise ValidationError.from_exception_data(cls.__name__, problems)
        return value

    @model_validator(mode="after")
    def _exactly_one_of_each_pair(self) -> Self:
        given = {key for key in type(self).model_fields if getattr(self, key) is not None}
        for keys in self.exactly_one:
            several = [key for key in keys if key in given]
            if len(several) > 1:
                found = "both" if len(keys) == 2 else " and ".join(several)
                raise ValueError(f"{one_of(keys)}, found {found}")
        if lacking := missing_pairs(type(self), dict.fromkeys(given, True), self.model_fields_set):
            raise missing_key("; ".join(lacking))
        return self

    @classmethod
    def record_for(cls, data: Any) -> "type[Door]":
        """Return the class for the keys of `data`: this one, unless overridden."""
        return cls


class CaseSpec(Door):
    """Body, mesh, model and load: the base of every organ's case.

    ``constants`` holds the constants that are not searched; missing ones keep their
    neutral values.

    Parameters
    ----------
    organ
        Name of the organ.
    reference
        The undeformed body.
    constants
        Values of constants that are held fixed, such as ``nu: 0.49``.
    """

    organ: str
    reference: Door = Field(description="the undeformed body")
    constants: dict[str, float] = Field(default_factory=dict)

    law_tissues: ClassVar[tuple[str, ...]] = ()
    """Tissues for which a case chooses a law from `workers.mechanics.materials.law_plugins`."""

    def __repr__(self) -> str:
        held = [f"{name} {value:.4g}" for name, value in self.constants.items()]
        return f"<Case of a {self.organ}, constants held: {', '.join(held) or 'none'}"[:498] + ">"

    @property
    @abstractmethod
    def parameters(self) -> Vocabulary:
        """Return the parameters that a study of this case can search or hold."""

    @property
    def vocabulary(self) -> Vocabulary:
        """Return all parameters that `complete` sets."""
        return self.parameters

    @cached_property
    def simulated(self) -> Mapping[str, Any]:
        """What a simulation depends on except body, mesh and constants, as plain values."""
        return read_only(self.model_dump(mode="json", exclude={"reference", "mesh", "constants"}))

    @property
    def plugged_modules(self) -> Sequence[str]:
        """Return the modules of the case's plug-ins, on which results depend."""
        return ()

    @abstractmethod
    def complete(self, constants: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return all constants, in internal names and units: given, set in the case, or neutral.

        Raises
        ------
        InputError
            If a name in `constants` is unknown or a value is not admissible.
        """

    def understood(self, searched: Collection[str]) -> list[tuple[str, str]]:
        """Return names and texts of the physical assumptions of a study, including defaults.

        Parameters
        ----------
        searched : collection of str
            Internal names of the parameters that are not held.
        """
        return []

    def unstated_load(self, searched: Collection[str]) -> str:
        """Return the keys of the load for which this case uses defaults, or "".

        Parameters
        ----------
        searched : collection of str
            Names of the searched parameters, as in a study file.
        """
        return "" if "load" in self.model_fields_set else "case.load"

    @property
    def mesh_nodes(self) -> int | None:
        """Return the approximate number of nodes of the mesh; None if the case does not set it."""
        return None

    def canonical(self, genes: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters in canonical form, equal for equal models."""
        return dict(genes)

    def identifiable(self, searched: Collection[str]) -> Identifiable:
        """Return the level of identifiability: stiffnesses, or only their ratios.

        Parameters
        ----------
        searched : collection of str
            Internal names of the parameters that are not held.
        """
        return "absolute"

    def common_scale(self, searched: Sequence[str]) -> tuple[str, ...]:
        """Return the searched stiffnesses whose common scale factor has no effect.

        Only their ratios are identifiable. None by default.

        Parameters
        ----------
        searched : sequence of str
            Internal names.
        """
        return ()

    def unused_parameter(self, name: str) -> str:
        """Return the reason why a parameter cannot be searched in this case, or ""."""
        return ""


class TargetSpec(Door):
    """Deformed body to match: simulated with hidden constants, or imaged."""

    constants: dict[str, float] | None = None

    @property
    def is_image(self) -> bool:
        """Whether the deformed body was imaged, not simulated."""
        return self.constants is None

    @property
    def is_aligned(self) -> bool:
        """Whether an image is first aligned with the undeformed body."""
        return False

    @property
    def understood(self) -> list[tuple[str, str]]:
        """How the image of the deformed body is read, as names and texts."""
        return []


class ScoreSpec(Door):
    """Compared parts, and the search's objective: the base of every organ's score.

    ``objective`` names a score of `workers.comparison.score_objective`.
    """

    later_keys: ClassVar[tuple[str, ...]] = ("objective",)

    objective: Annotated[str, Field(description="the score that the search optimises")] = (
        DEFAULT_OBJECTIVE
    )

    @field_validator("objective")
    @classmethod
    def _is_a_score(cls, name: str) -> str:
        return checked_name("scores", name)

    @property
    def parts(self) -> tuple[str, ...]:
        """Return the names of the compared parts, as used by `Organ.scores_by_part`."""
        return ()

    @property
    def compared(self) -> str:
        """Return the compared parts in words, such as ``glandular tissue``."""
        return " and ".join(self.parts)

    @property
    def extent(self) -> tuple[str, str]:
        """Return the organ's words for overlap and distance."""
        return "area", "contours"


Record = TypeVar("Record", bound=BaseModel)


def validated(model: type[Record], data: Any, where: str = "", text: str = "") -> Record:
    """Validate `data` as a `model`.

    Parameters
    ----------
    model : type
        Record of this module, or of the study.
    data : mapping
        Content of YAML or JSON.
    where : str, optional
        Name of the file, for the message.
    text : str, optional
        The YAML that `data` was read from, for the line of each value in the message.

    Raises
    ------
    InputError
        If any key is invalid; lists each with the value found and the value expected.
    """
    written = WrittenValues(text, StrictLoader)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        if _with_text_as_written(data, error, written):
            return validated(model, data, where, text)
        keys = model.record_for(data) if issubclass(model, Door) else model
        problems = explain(error, keys, written)
        raise InputError(f"{_head(error, where or 'This')}:\n{problems}") from error


def _with_text_as_written(data: Any, error: ValidationError, written: WrittenValues) -> bool:
    """Replace numbers by their text where text is asked; return True if there are any.

    Studies written as YAML 1.1 may have names such as 1e3 and 08, which are text there.
    """
    replaced = False
    for problem in error.errors(include_url=False):
        source = written.source(problem["loc"])
        if problem["type"] == "string_type" and is_text_in_older_yaml(source):
            *above, last = problem["loc"]
            inside = reduce(getitem, above, data)
            inside[last], replaced = source, True
    return replaced


def _head(error: ValidationError, where: str) -> str:
    if all(is_missing(e) for e in errors_with_pairs(error, BaseModel)):
        return f"{where} is not finished. Fill in what is missing"
    return f"{where} does not make sense"


def explain(
    error: ValidationError,
    model: type[BaseModel] = BaseModel,
    written: WrittenValues = WrittenValues("", StrictLoader),  # noqa: B008 - never changed
) -> str:
    """Return one line per invalid key: its path, the expected value and the value found.

    `model` describes missing keys; `written` has the lines of the values.

    Examples
    --------
    >>> class Load(Door):
    ...     force_n: Positive
    >>> try:
    ...     Load.model_validate({"force_n": -3})
    ... except ValidationError as error:
    ...     print(explain(error))
      force_n: Input should be greater than 0, found -3
    """
    return "\n".join(_line(e, model, written) for e in errors_with_pairs(error, model))


# Lists that refer to lists can exhaust memory when expanded.
_SHORT = reprlib.Repr()
_SHORT.maxdict = _SHORT.maxlist = _SHORT.maxtuple = 10
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxother = 3, 60, 60


# Pydantic's words for lists and mappings are those of Python, not of YAML.
_EXPECTED = {
    "model_type": "expected keys with values",
    "dict_type": "expected keys with values",
    "tuple_type": "expected a list in brackets, such as [5, 20]",
    "list_type": "expected a list in brackets, such as [1, 2]",
    "string_type": "expected a text",
} | dict.fromkeys(("float_type", "float_parsing"), "expected a number, such as 12.5")
_EXPECTED |= dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "expected a whole number")
_EXPECTED |= dict.fromkeys(("bool_type", "bool_parsing"), "expected true or false")


def _line(error: Mapping[str, Any], model: type[BaseModel], written: WrittenValues) -> str:
    # A part such as "tuple[float, float]" is one of the forms that a value may have.
    parts = [str(part) for part in error["loc"]]
    path = ".".join(part for part in parts if not part.startswith(("constrained-", "tuple[")))
    start = f"  {path}: " if path else "  "
    if is_missing(error):
        text = missing_text(error, model)
        return f"{start}{text}"
    if error["type"] == "value_error":
        return f"{start}{error['ctx']['error']}"
    limits = error.get("ctx") or {}
    if error["type"] == "too_long" and "max_length" in limits:
        expected = f"expected at most {limits['max_length']} values"
    elif error["type"] == "too_short" and "min_length" in limits:
        least = limits["min_length"]
        expected = f"expected at least {least} value{'s' if least > 1 else ''}"
    else:
        expected = _EXPECTED.get(error["type"], error["msg"])
        if limits.get("pattern") == NAME_PATTERN:
            expected = (
                "expected at most 64 letters (a to z, A to Z), digits, '.', '_' and '-', with a "
                "letter or digit first"
            )
    input_text = _SHORT.repr(error["input"])
    input_text = input_text if len(input_text) <= 60 else f"{input_text[:57]}..."
    line = written.line(error["loc"])
    place = "" if line is None else f" on line {line}"
    advice = _instead(error, written.source(error["loc"]))
    return f"{start}{expected}, found {input_text}{place}{f': {advice}' if advice else ''}"


def _instead(error: Mapping[str, Any], source: str) -> str:
    """Return what to write instead of an invalid value, or ""."""
    kind, value = error["type"], error["input"]
    if kind in ("float_parsing", "int_parsing") and isinstance(value, str):
        return number_to_write(value)
    if kind == "string_type" and isinstance(value, int | float):
        text = source or ("true" if value is True else "false" if value is False else str(value))
        return f'write "{text}" in quotes'
    if kind == "too_long" and re.search(r"\d,\d", source):
        return "decimals have a point, such as 5.0"
    if kind == "string_pattern_mismatch" and error["ctx"]["pattern"] == NAME_PATTERN:
        name = plain_name(str(value))
        return f"write {name}" if name else ""
    return ""


_SPELLED = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss", "ø": "o"}
)


def plain_name(name: str) -> str:
    """Return the closest valid `Name`, or "".

    Examples
    --------
    >>> plain_name("Müller 1"), plain_name("été/left")
    ('Mueller_1', 'ete_left')
    """
    spelled = normalize("NFKD", normalize("NFC", name).translate(_SPELLED))
    plain = spelled.encode("ascii", "ignore").decode().strip()
    return re.sub(r"[^A-Za-z0-9._-]+", "_", plain).lstrip("._-").rstrip("_")[:64]
