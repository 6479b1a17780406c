"""Keys of the recordings of a bench experiment: markers, and fields of displacement."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from palpate.workers.common_keys import Door, Finite, Positive
from palpate.workers.organs.specimen.specimen_body_keys import FinitePoint


class MarkerSpec(Door):
    """Stated position of a marker on the surface of the body.

    ``outward`` is the normal of the surface there; the default is the normal of the nearest face.

    Parameters
    ----------
    outward
        Normal of the surface at the marker. Default: the normal of the nearest face.
    """

    at_mm: FinitePoint = Field(description="[x, y, z] in mm on the surface of the body at rest")
    outward: FinitePoint | None = None

    @model_validator(mode="after")
    def _some_direction(self) -> Self:
        if self.outward is not None and not np.linalg.norm(self.outward) > 0:
            raise ValueError("outward must not be zero")
        return self


class FrameSpec(Door):
    """Position of the cameras relative to the body, from markers at rest.

    The positions of all markers, including the base markers, are aligned by a rigid motion.

    Parameters
    ----------
    at_rest_mm
        Positions of at least three markers in the frame of the body, [x, y, z] in mm at rest.
    """

    at_rest_mm: Annotated[dict[str, FinitePoint], Field(min_length=3)]


Window = tuple[Finite, Finite]


class MarkersSpec(Door):
    """Recordings of markers: a table per file, a row per time.

    ``column`` is the pattern of column names, with the marker and the axis. The displacement of
    a marker is its mean position in ``loaded_s`` minus its mean position in ``rest_s``. Negative
    times count from the end of the recording. Empty cells, nan and the placeholders of trackers
    for a lost marker are missing values. ``noise_confirmed: true`` accepts repeats that scatter
    by far more than ``sd_mm``.

    Parameters
    ----------
    time
        Column of the time in s.
    column
        Names of the other columns, with ``{marker}`` and ``{axis}``.
    mm_per_unit
        Length of one unit of the recordings, in mm.
    frame
        The position of the cameras. Default: recordings are in the frame of the body.
    sd_mm
        Error of one component of one marker, standard deviation in mm.
    common_sd_mm
        Error that all markers of a recording share, standard deviation in mm.
    noise_confirmed
        Accepts repeats that scatter by far more than `sd_mm`.
    """

    time: str = "t_s"
    column: str = "{marker}_{axis}_mm"
    mm_per_unit: Positive = 1.0
    rest_s: Window = Field(
        description="[from, to] in s before any motion; negative times count from the end"
    )
    loaded_s: Window = Field(
        description="[from, to] in s after all motion; negative times count from the end"
    )
    markers: Annotated[dict[str, MarkerSpec], Field(min_length=1)] = Field(
        description="the markers, by their names in the recordings"
    )
    frame: FrameSpec | None = None
    sd_mm: Positive = 0.1
    common_sd_mm: Positive | None = None
    noise_confirmed: bool = False

    @model_validator(mode="after")
    def _named_places(self) -> Self:
        if "{marker}" not in self.column or "{axis}" not in self.column:
            raise ValueError("column needs {marker} and {axis} in it, as in '{marker}_{axis}_mm'")
        rest = self.column.replace("{marker}", "").replace("{axis}", "")
        if "{" in rest or "}" in rest:
            raise ValueError(
                f"column may have no braces except in {{marker}} and {{axis}}, found "
                f"{self.column[:60]!r}"
            )
        return self


class FieldSpec(Door):
    """Displacements of landmarks, nodes or image correlation: a table per file, a row per point.

    The columns ``x_mm``, ``y_mm`` and ``z_mm`` are the positions of the points at rest in the
    frame of the body; ``ux_mm``, ``uy_mm`` and ``uz_mm`` are their displacements. One or two
    displacement columns may be absent, and single cells empty or nan: missing components are not
    compared. All recordings must list the same points in the same order.

    ``sd_mm`` is the standard deviation of one component of one point, ``common_sd_mm`` of an
    error that all points of a recording share, such as a motion of the camera.
    ``noise_confirmed: true`` accepts repeats that scatter by far more.

    Parameters
    ----------
    sd_mm
        Error of one component of one point, standard deviation in mm.
    common_sd_mm
        Error that all points of a recording share, such as a motion of the camera, standard
        deviation in mm.
    noise_confirmed
        Accepts repeats that scatter by far more than `sd_mm`.
    """

    sd_mm: Positive
    common_sd_mm: Positive | None = None
    noise_confirmed: bool = False
