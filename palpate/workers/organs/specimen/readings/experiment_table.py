"""Summary of the file of an experiment as a table."""

from palpate.workers.organs.specimen.keys.bodies import BodySpec
from palpate.workers.organs.specimen.keys.loads import LoadsSpec, StateSpec
from palpate.workers.organs.specimen.keys.materials import MaterialSpec
from palpate.workers.organs.specimen.spec import SpecimenSpec


def understood(spec: SpecimenSpec) -> list[tuple[str, str]]:
    """Return the inputs of a diagnosis as names and texts."""
    markers, field = spec.markers, spec.field
    rows = [
        ("experiment", spec.name),
        ("body", _body(spec.body)),
        *((name, _material(one)) for name, one in spec.materials.items()),
        ("held", "; ".join(f"{h.region} along {', '.join(h.axes)}" for h in spec.holds) or "no"),
        ("gravity", spec.gravity),
    ]
    if markers is not None:
        rows.append(("markers", f"{len(markers.markers)}, sd {markers.sd_mm:g} mm"))
    if field is not None:
        rows.append(("displacement field", f"sd {field.sd_mm:g} mm"))
    states = (
        (f"state {s.name}", "; ".join([_loads(s), *_reactions(s), ", ".join(s.files)]))
        for s in spec.states
    )
    return [*rows, *states, *((f"to predict: {p.name}", _loads(p)) for p in spec.predict)]


def _body(body: BodySpec) -> str:
    if body.box_mm is not None:
        return "block of " + " x ".join(f"{s:g}" for s in body.box_mm) + " mm"
    if body.sheet is None:
        return f"{body.mesh}, {body.mm_per_unit:g} mm per unit"
    thick = f", {body.sheet.thickness_mm:g} mm thick"
    if body.sheet.size_mm is not None:
        return "sheet of " + " x ".join(f"{s:g}" for s in body.sheet.size_mm) + " mm" + thick
    return f"sheet with {len(body.sheet.corners_mm)} corners{thick}"


def _material(material: MaterialSpec) -> str:
    low, high = material.E_kpa
    nu = material.nu
    nus = f"searched from {nu[0]:g} to {nu[1]:g}" if isinstance(nu, tuple) else f"{nu:g}"
    shape = "".join(
        f", {name} expected from {value[0]:g} to {value[1]:g}"
        if isinstance(value, tuple)
        else f", {name} {value:g}"
        for name, value in material.constants.items()
    )
    return (
        f"{material.law}{shape}, E expected from {low:g} to {high:g} kPa, nu {nus}, "
        f"{material.density_kg_per_m3:g} kg/m3"
    )


def _reactions(state: StateSpec) -> list[str]:
    return [
        f"{r.region} pushed along {r.axis} with {r.force_n:g} N, sd {r.sd_n:g} N"
        for r in state.reactions
    ]


def _loads(loads: LoadsSpec) -> str:
    texts = [
        f"{f.mass_g:g} g on {f.region}"
        if f.force_n is None
        else f"({', '.join(f'{c:g}' for c in f.force_n)}) N on {f.region}"
        for f in loads.forces
    ]
    texts += [
        f"{m.region} moved as measured"
        if m.displacement_mm is None
        else f"{m.region} moved by ({', '.join(f'{c:g}' for c in m.displacement_mm)}) mm"
        for m in loads.moves
    ]
    if loads.pressure_kpa:
        texts.append(f"pressure of {loads.pressure_kpa:g} kPa")
    return "; ".join(texts) or "no load"
