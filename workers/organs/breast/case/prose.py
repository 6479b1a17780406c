"""A case in prose, case.json, read strictly: what is not understood is refused and named.

Two shapes are read: cases that were made with FEBio, and what `palpate blind` writes. Every text
is a list of known phrases.
"""

from collections.abc import Mapping
from typing import Any, Self

from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.workers.mechanics.parameters import unknown_name
from palpate.workers.organs.breast.case.known_phrases import Phrase, formula, read_phrases, remark
from palpate.workers.organs.breast.case.spec import CaseFile
from palpate.workers.spec import Door, validated

# Words of the labels, and the tissue that each is. Skin in a scan is counted as fat.
LABEL_WORDS = {
    "air": "air",
    "background": "air",
    "fat": "fat",
    "adipose": "fat",
    "skin": "fat",
    "glandular": "glandular",
    "gland": "glandular",
    "fibroglandular": "glandular",
}
LABELS = [
    *(Phrase(rf"{word}(?: tissue)?", word, {"is": tissue}) for word, tissue in LABEL_WORDS.items()),
    remark(r"\((?:skin and ligaments )?counted as fat\)"),
]
UNITS = [Phrase("mm, N, kPa", "mm, N, kPa")]
DIRECTIONS = [
    remark(r"# mm axis"),
    Phrase(r"\(?(?:cranio-caudal|medio-lateral|vertical)\)?", "cranio-caudal"),
]
AXES = {
    "x": DIRECTIONS,
    "y": [
        *DIRECTIONS,
        Phrase("compression axis", "compression axis"),
        Phrase(r"lower plate at y = (?P<lower_mm>#)", "lower plate at y=-50"),
        Phrase(r"upper plate at y = (?P<upper_mm>#)", "upper plate at y=+50"),
        remark(r"\(fixed\)"),
        remark(r"\(moves along -y\)"),
    ],
    "z": [
        Phrase(
            r"chest wall z = (?P<z_mm>#) -> nipple z = (?P<nipple_mm>#)",
            "chest wall z=0 -> nipple z=50",
        )
    ],
}
NEO_HOOKEAN = "W = mu/2 (I1bar-3) + 1/d (J-1)^2"
TENSION = r"fib(?:re|er)s? in tension[ -]only|(?:fib(?:re|er)s?[ :])?tension[ -]only"
ENERGY = [
    formula(NEO_HOOKEAN, law="neo-hookean"),
    formula(f"{NEO_HOOKEAN} + eta/2 (I4bar-1)^2", law="fibre-neo-hookean", invariant="isochoric"),
    formula(f"{NEO_HOOKEAN} + eta/2 (I4-1)^2", law="fibre-neo-hookean", invariant="I4"),
    Phrase(TENSION, "fibre in tension only", {"fibres": "tension-only"}),
    Phrase(
        r"fib(?:re|er)s? in tension and compression",
        "fibre in tension and compression",
        {"fibres": "literal"},
    ),
    formula("mu=E/(2(1+nu))"),
    formula("d=2/K"),
    formula("K=E/(3(1-2nu))"),
]
ETA = [Phrase("one value for fat and glandular", "one value for fat and glandular")]
WALL = [
    Phrase(r"(?:all nodes )?at z = (?P<z_mm>#)", "all nodes at z=0"),
    Phrase(r"uz = 0", "uz=0"),
    Phrase(r"ux = uy = uz = 0", "ux=uy=uz=0", {"held": True}),
    remark(r"(?:tangential )?(?:distributed )?springs"),
    Phrase(r"kx = (?P<kx_kpa_per_mm>#) kPa ?/ ?mm", "kx=0.2 kPa/mm"),
    Phrase(r"ky = (?P<ky_kpa_per_mm>#) kPa ?/ ?mm", "ky=0.001 kPa/mm"),
    remark(r"\(force per area per mm\)"),
    Phrase(r"otherwise free|free otherwise", "otherwise free"),
]
PLATES = [
    Phrase("two rigid flat plates", "two rigid flat plates"),
    Phrase(r"normal to (?:y|the compression axis of each scan)", "normal to y"),
    Phrase("frictionless", "frictionless"),
    remark("unilateral"),
    Phrase(
        r"(?:the )?lower (?:plate )?(?:is )?(?:fixed )?at y = (?P<lower_mm>#)", "lower at y=-50"
    ),
    Phrase(r"(?:the )?upper (?:plate )?(?:is )?at y = (?P<upper_mm>#)", "upper at y=50"),
    remark(r"the lower stands still"),
    remark(r"(?:the )?upper only translates along (?:y|the axis)"),
    remark(r"force[- ]controlled"),
    remark(r"along y"),
]
GRAVITY = [
    Phrase("none", "none"),
    remark(
        r"\(reference and deformed scans? in the same posture, reference taken as stress free\)"
    ),
]
SKIN = [Phrase("none", "none")]
SEGMENTATION = [
    remark("each scan segmented independently"),
    remark(r"(?:signed-distance )?noise"),
    Phrase(r"sd (?P<sd_mm>#) mm", "sd 0.3 mm"),
    Phrase(r"correlation length (?:about )?(?P<correlation_mm>#) mm", "correlation length 4 mm"),
    remark("on body outline and glandular boundary"),
    Phrase(r"reference (?:scan )?included", "reference scan included", {"in_scans": "all"}),
    Phrase(
        r"reference (?:scan )?(?:excluded|not included)",
        "reference scan excluded",
        {"in_scans": "loaded"},
    ),
]
CONSTANTS = {"E_fat": "E_fat_kpa", "E_gl": "E_glandular_kpa", "eta": "eta_kpa"}


class _ProseLoad(Door):
    file: str
    plate_force_N: float | None = None  # noqa: N815
    plate_distance_mm: float | None = None
    compression_axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    lower_mm: float | None = None
    upper_mm: float | None = None

    @model_validator(mode="after")
    def _one_load(self) -> Self:
        if (self.plate_force_N is None) == (self.plate_distance_mm is None):
            raise ValueError("give plate_force_N or plate_distance_mm, one of them")
        if self.compression_axis[2] or not any(self.compression_axis):
            raise ValueError("compression_axis must lie across z, such as [0, 1, 0] or [1, 0, 0]")
        return self


class _ProseScans(Door):
    reference: str
    reference_repeat: str | None = None
    pose_sd_mm: float | None = None
    pose_sd_deg: float | None = None
    deformed: tuple[_ProseLoad, ...]


class _Nominal(Door):
    energy: str
    nu: float
    fibre_direction: tuple[float, float, float] | None = None
    eta: str = ""
    unknown_constants: tuple[str, ...]
    plausible_kPa: dict[str, tuple[float, float]]  # noqa: N815
    held_kPa: dict[str, float] = Field(default_factory=dict)  # noqa: N815
    chest_wall: str
    plates: str
    gravity: str = "none"
    skin: str = "none"


class _Axes(Door):
    x: str = ""
    y: str = ""
    z: str = ""


class _Prose(Door):
    id: str
    units: str = ""
    axes: _Axes = _Axes()
    labels: dict[int, str] = Field(default_factory=lambda: {0: "air", 1: "fat", 2: "glandular"})
    nominal: _Nominal
    segmentation: str = ""
    scans: _ProseScans


def is_prose(data: Mapping[str, Any]) -> bool:
    """Return whether what a file says is a case in prose."""
    return "nominal" in data


def from_prose(data: Mapping[str, Any], where: str) -> CaseFile:
    """Return what a case in prose says.

    Parameters
    ----------
    data : mapping
        What case.json holds.
    where : str
        Its path, for messages.

    Raises
    ------
    InputError
        If a key or a phrase is not known, or something is missing or contradicts itself.
    """
    prose = validated(_Prose, data, where)
    for key, text in (
        ("nominal.gravity", prose.nominal.gravity),
        ("nominal.skin", prose.nominal.skin),
    ):
        read_phrases(
            text or "none", GRAVITY if key.endswith("gravity") else SKIN, f"{where}: {key}"
        )
    read_phrases(prose.nominal.eta, ETA, f"{where}: nominal.eta")
    if prose.units:
        read_phrases(prose.units, UNITS, f"{where}: units")
    axes = _axes(prose, where)
    return validated(
        CaseFile,
        {
            "name": prose.id,
            "model": _model(prose.nominal, where),
            "wall": _wall(prose.nominal.chest_wall, axes, where),
            "plates": _plates(prose.nominal.plates, axes, where),
            "constants": _constants(prose.nominal, where),
            "noise": _noise(prose, where),
            "scans": _scans(prose, where),
        },
        where,
    )


def _axes(prose: _Prose, where: str) -> dict[str, float]:
    stated: dict[str, float] = {}
    for name, phrases in AXES.items():
        text = getattr(prose.axes, name)
        if text:
            stated |= read_phrases(text, phrases, f"{where}: axes.{name}")
    if "nipple_mm" in stated and not stated["nipple_mm"] > stated["z_mm"]:
        raise InputError(
            f"{where}: axes.z says {prose.axes.z!r}, expected the nipple at a larger z than the "
            "chest wall."
        )
    return stated


def _model(nominal: _Nominal, where: str) -> dict[str, Any]:
    stated = read_phrases(nominal.energy, ENERGY, f"{where}: nominal.energy")
    if "law" not in stated:
        raise InputError(
            f"{where}: nominal.energy does not say {NEO_HOOKEAN}: found {nominal.energy!r}."
        )
    model = {"law": stated["law"], "nu": nominal.nu}
    if stated["law"] == "neo-hookean":
        return model
    model |= {"fibres": stated.get("fibres", "literal"), "fibre_invariant": stated["invariant"]}
    if nominal.fibre_direction is not None:
        model["fibre_direction"] = nominal.fibre_direction
    return model


def _wall(text: str, axes: Mapping[str, float], where: str) -> dict[str, Any]:
    stated = read_phrases(text, WALL, f"{where}: nominal.chest_wall")
    z_mm = _agreed("z_mm", stated, axes, where)
    if z_mm is None:
        raise InputError(f"{where} does not say chest_wall: .. z=..: found {text!r}.")
    return stated | {"z_mm": z_mm}


def _plates(text: str, axes: Mapping[str, float], where: str) -> dict[str, Any] | None:
    stated = read_phrases(text, PLATES, f"{where}: nominal.plates")
    places = {key: _agreed(key, stated, axes, where) for key in ("lower_mm", "upper_mm")}
    known = {key: place for key, place in places.items() if place is not None}
    if len(known) == 1:
        raise InputError(
            f"{where} says where one plate is, expected both in nominal.plates, as in lower at "
            f"y=-50, upper at y=50: found {text!r}."
        )
    return known or None


def _agreed(
    key: str, stated: Mapping[str, Any], axes: Mapping[str, float], where: str
) -> float | None:
    """Return a place that the axes may say as well."""
    here, there = stated.get(key), axes.get(key)
    if here is not None and there is not None and here != there:
        raise InputError(
            f"{where} contradicts itself: axes put {key} at {there:g}, nominal at {here:g}."
        )
    return here if here is not None else there


def _constants(nominal: _Nominal, where: str) -> dict[str, Any]:
    """Return held values and searched intervals, by the names of a structured case."""
    unknown, held, plausible = nominal.unknown_constants, nominal.held_kPa, nominal.plausible_kPa
    for key, names in (
        ("unknown_constants", unknown),
        ("held_kPa", held),
        ("plausible_kPa", plausible),
    ):
        for name in names:
            if name not in CONSTANTS:
                wrong = unknown_name("constant", name, CONSTANTS)
                raise InputError(f"{where}: nominal.{key}: {wrong}")
    if missing := set(unknown) - set(plausible):
        raise InputError(
            f"{where}: nominal.plausible_kPa lacks an interval for {', '.join(sorted(missing))}."
        )
    needed = {"E_fat", "E_gl"} | ({"eta"} if "eta/2" in nominal.energy.replace(" ", "") else set())
    if loose := needed - set(unknown) - set(held):
        raise InputError(
            f"{where} gives no value of {', '.join(sorted(loose))}: name it in "
            "nominal.unknown_constants, or hold it in nominal.held_kPa."
        )
    if both := set(unknown) & set(held):
        raise InputError(
            f"{where}: {', '.join(sorted(both))} is in nominal.unknown_constants and in "
            "nominal.held_kPa; expected one of them."
        )
    return {CONSTANTS[n]: held[n] if n in held else plausible[n] for n in (*held, *unknown)}


def _noise(prose: _Prose, where: str) -> dict[str, Any] | None:
    stated = read_phrases(prose.segmentation, SEGMENTATION, f"{where}: segmentation")
    if not prose.segmentation and prose.scans.reference_repeat is not None:
        return None
    for key, words in (("sd_mm", "sd .. mm"), ("correlation_mm", "correlation length .. mm")):
        if key not in stated:
            raise InputError(
                f"{where} does not say segmentation: {words}: found {prose.segmentation!r}."
            )
    return {"in_scans": "loaded"} | stated


def _scans(prose: _Prose, where: str) -> dict[str, Any]:
    labels = {
        number: read_phrases(text, LABELS, f"{where}: labels.{number}").get("is")
        for number, text in prose.labels.items()
    }
    loads = [
        {
            "file": load.file,
            "force_n": load.plate_force_N,
            "plate_distance_mm": load.plate_distance_mm,
            "axis": load.compression_axis,
            "lower_mm": load.lower_mm,
            "upper_mm": load.upper_mm,
        }
        for load in prose.scans.deformed
    ]
    return {
        "reference": prose.scans.reference,
        "reference_repeat": prose.scans.reference_repeat,
        "pose_sd_mm": prose.scans.pose_sd_mm,
        "pose_sd_deg": prose.scans.pose_sd_deg,
        "labels": labels,
        "loads": loads,
    }
