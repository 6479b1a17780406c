"""Keys of an experiment that say how its recordings are read."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from palpate.workers.spec import Door, Finite, Positive

FinitePoint = tuple[Finite, Finite, Finite]


class MarkerSpec(Door):
    """Where a marker is believed to sit on the surface of the body.

    ``outward`` is the normal of the surface there; without it that of the nearest face
    counts.

    Parameters
    ----------
    outward
        Normal of the surface at the marker. Default: that of the nearest face.
    """

    at_mm: FinitePoint = Field(description="[x, y, z] in mm on the surface of the body at rest")
    outward: FinitePoint | None = None

    @model_validator(mode="after")
    def _some_direction(self) -> Self:
        if self.outward is not None and not np.linalg.norm(self.outward) > 0:
            raise ValueError("outward must not be zero")
        return self


class FrameSpec(Door):
    """How the frame of the cameras lies to that of the body.

    Places in the frame of the body that markers have at rest, the base included; a rigid
    motion is fitted to them.

    Parameters
    ----------
    at_rest_mm
        Positions of at least three markers in the frame of the body, [x, y, z] in mm at rest.
    """

    at_rest_mm: Annotated[dict[str, FinitePoint], Field(min_length=3)]


Window = tuple[Finite, Finite]


class MarkersSpec(Door):
    """Recordings of markers: a table a file, a row a moment.

    ``column`` names the columns, with the marker and the axis in it. A marker's
    displacement is its mean place in ``loaded_s`` less its mean place in ``rest_s``. Times below
    zero count from the end of the recording. An empty cell, nan, and whatever a tracker writes for
    a marker that it has lost, is a missing value. ``noise_confirmed: true`` accepts repeats that
    scatter by far more than ``sd_mm``.

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
        description="[from, to] in s when nothing had moved yet; below zero from the end"
    )
    loaded_s: Window = Field(
        description="[from, to] in s when nothing moved any more; below zero from the end"
    )
    markers: Annotated[dict[str, MarkerSpec], Field(min_length=1)] = Field(
        description="the markers by the names in the recordings"
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
                f"column may hold no braces but those of {{marker}} and {{axis}}, found "
                f"{self.column[:60]!r}"
            )
        return self


class FieldSpec(Door):
    """Displacements of landmarks, nodes or image correlation: a table a file, a row a point.

    The columns ``x_mm``, ``y_mm`` and ``z_mm`` place the points on the body at rest, in its
    frame; ``ux_mm``, ``uy_mm`` and ``uz_mm`` are their displacements, of which one or two
    columns may be absent and single cells empty or nan: what was not measured is not compared.
    All recordings list the same points in the same order.

    ``sd_mm`` is the standard deviation of one component of one point, ``common_sd_mm`` of an
    error that all points of a recording share, such as a motion of the camera.
    ``noise_confirmed: true`` accepts repeats that scatter by far more than that.

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
