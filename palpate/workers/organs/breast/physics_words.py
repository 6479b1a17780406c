"""Descriptions of the physics of a breast, for studies and diagnoses."""

from palpate.storage.values import Triple


def law_text(
    fibres: str, fibre_invariant: str, direction: Triple, matrix: str = "neo-Hookean"
) -> str:
    """Describe the law of tissue with fibres.

    Examples
    --------
    >>> law_text("tension-only", "I4", (0.0, 0.0, 1.0))
    'neo-Hookean, fibres along (0, 0, 1) that act in tension only, full (I4) stretch'
    """
    pulled = "in tension only" if fibres == "tension-only" else "in compression as well"
    stretch = "isochoric" if fibre_invariant == "isochoric" else "full (I4)"
    along = ", ".join(f"{c:g}" for c in direction)
    return f"{matrix}, fibres along ({along}) that act {pulled}, {stretch} stretch"


def wall_text(held: bool, kx_kpa_per_mm: float, ky_kpa_per_mm: float) -> str:
    """Describe the support of the body at the chest wall.

    Examples
    --------
    >>> wall_text(False, 0.0, 0.0)
    'held along z, slides along x and y'
    """
    if held:
        return "held in all directions"
    if not kx_kpa_per_mm and not ky_kpa_per_mm:
        return "held along z, slides along x and y"
    springs = f"springs of {kx_kpa_per_mm:g} kPa/mm along x and {ky_kpa_per_mm:g} kPa/mm along y"
    return f"held along z, {springs}"
