"""What the store holds for the tasks: made when it is missing, read once by each process."""

import threading
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from storage.arrays import load_meta
from storage.digest import array_digest, digest, file_digest, source_digest
from storage.errors import InputError
from storage.meshes import has_mesh, load_mesh, save_mesh
from storage.stores import Store
from storage.values import Tissue, Volume
from storage.volumes import has_volume, list_volumes, load_volume, save_volume, volume_meta
from workers import pipeline
from workers.fem.model import Model, prepare
from workers.images.labels import default_map, label_counts
from workers.mesh.hierarchy import Hierarchy, from_arrays, to_arrays
from workers.organs.breast import Extent, extent_of
from workers.pipeline import Watch
from workers.resources import CACHE
from workers.similarity.score import Scorer
from workers.spec import ImageSpec, MeshSpec, ModelSpec, PhantomSpec, ReferenceSpec, ScoreSpec

PHYSICS = ("phantom", "images", "mesh", "fem", "imaging", "similarity", "organs")


@cache
def code_version(*rooms: str) -> str:
    """A digest of the source of these packages of `workers`; of all physics by default."""
    here = Path(__file__).parent
    return source_digest([here / room for room in rooms or PHYSICS])


class Library:
    """The volumes, meshes and scorers of one store, by digest."""

    def __init__(self, store: Store) -> None:
        self.store = store

    def reference(self, spec: ReferenceSpec) -> str:
        """The digest of the undeformed body, which is then in the store.

        Raises
        ------
        InputError
            If its image cannot be read, or is neither a file nor in the store.
        """
        return self.image(spec) if spec.phantom is None else self._phantom(spec.phantom)

    def image(self, spec: ImageSpec) -> str:
        """The digest of an image as tissues, which is then in the store.

        It is named after the content of the file and how it is read. What is no file
        is the digest or the name of a stored volume.

        Raises
        ------
        InputError
            If it cannot be read, or is neither a file nor in the store.
        """
        given = str(spec.volume)
        path = Path(given)
        how = spec.model_dump(mode="json", include={"labels", "spacing_mm", "axes"})
        if not path.exists():
            return self._stored(given, spec)
        name = digest("image", path.suffix, file_digest(path), how, code_version("images"))
        if not has_volume(self.store, name):
            volume = pipeline.image(path, spec)
            save_volume(self.store, name, volume, meta={"kind": "image", "file": path.name})
        return name

    def add(self, volume: Volume, meta: dict[str, Any]) -> str:
        """Store a volume under the digest of its content."""
        place = [list(volume.spacing_mm), list(volume.origin_mm)]
        name = digest("volume", array_digest(volume.values), place)
        if not has_volume(self.store, name):
            save_volume(self.store, name, volume, meta=meta)
        return name

    def mesh(self, volume: str, spec: MeshSpec, model: ModelSpec) -> tuple[str, dict[str, Any]]:
        """The digest of the mesh of a stored body, and facts of both; the mesh is then stored."""
        layer = model.skin == "layer"
        version = code_version("mesh", "organs")
        name = digest("mesh", volume, spec.model_dump(mode="json"), layer, version)
        if not has_mesh(self.store, name):
            watch = Watch()
            labels = self.volume(volume)
            with watch.stage("mesh"):
                hierarchy = pipeline.mesh(labels, spec, model)
            facts = _facts(labels, hierarchy) | {"seconds": watch.seconds}
            save_mesh(self.store, name, to_arrays(hierarchy), {"volume": volume, "facts": facts})
        return name, load_meta(self.store.layout.mesh(name))["facts"]

    def volume(self, name: str) -> Volume:
        """A stored volume."""
        return CACHE.get(self._key("volume", name), lambda: load_volume(self.store, name))

    def extent(self, name: str, oblique_deg: float = 0.0) -> Extent:
        """Where the body of a stored volume begins and ends along y."""
        return CACHE.get(
            self._key(f"extent {oblique_deg:g}", name),
            lambda: extent_of(self.volume(name), oblique_deg),
        )

    def hierarchy(self, name: str) -> Hierarchy:
        """A stored mesh."""
        return CACHE.get(
            self._key("mesh", name), lambda: from_arrays(load_mesh(self.store, name)[0])
        )

    def model(self, name: str) -> Model:
        """A stored mesh, prepared for the solver."""
        return CACHE.get(self._key("model", name), lambda: prepare(self.hierarchy(name)))

    def scorer(self, target: str, spec: ScoreSpec) -> Scorer:
        """What compares candidates with a stored target; each thread has its own."""
        key = (*self._key("scorer", target), spec.labels, spec.surface, threading.get_ident())
        return CACHE.get(key, lambda: pipeline.scorer(self.volume(target), spec))

    def imaged(self, name: str) -> bool:
        """Whether a stored volume comes from an image rather than from a simulation."""
        return volume_meta(self.store, name).get("kind") not in ("simulated", "evaluation")

    def _key(self, kind: str, name: str) -> tuple[str, str, str]:
        return kind, str(self.store.root), name

    def _phantom(self, spec: PhantomSpec) -> str:
        settings = asdict(spec.settings) | {"seed": spec.seed}
        name = digest("phantom", settings, code_version("phantom"))
        if not has_volume(self.store, name):
            meta = {"kind": "phantom", "settings": settings}
            save_volume(self.store, name, pipeline.phantom(spec), meta=meta)
        return name

    def _stored(self, given: str, spec: ImageSpec) -> str:
        name = self._find(given)
        if spec.spacing_mm is not None or spec.axes is not None:
            raise InputError(
                f"{given} is a volume of the store, which has its spacing and axes: take "
                "spacing_mm and axes out, or give the file."
            )
        if spec.labels is None:
            default_map(self.volume(name))
            return name
        return self.add(pipeline.as_tissues(self.volume(name), spec), {"kind": "image"})

    def _find(self, given: str) -> str:
        """The digest of the stored volume that has this digest or name."""
        stored = list_volumes(self.store)
        if given in stored:
            return given
        named = [v for v in stored if volume_meta(self.store, v).get("name") == given]
        if len(named) == 1:
            return named[0]
        if named:
            raise InputError(f"{given} names several volumes: give one of {', '.join(named)}.")
        raise InputError(
            f"{given} is neither a file or folder (looked up from {Path.cwd()}) nor a volume of "
            f"the store {self.store.root}. Check the path, or import the image first."
        )


def _facts(labels: Volume, hierarchy: Hierarchy) -> dict[str, Any]:
    count = {Tissue(t): n for t, n in label_counts(labels).items() if t != Tissue.AIR}
    ml = {t.name.lower(): n * labels.voxel_mm3 / 1000 for t, n in count.items()}
    inside = sum(n for t, n in count.items() if t != Tissue.SKIN)
    finest = hierarchy.finest
    return {
        "voxels": sum(count.values()),
        "spacing_mm": list(labels.spacing_mm),
        "body_y_mm": list(extent_of(labels)),
        "volume_ml": sum(ml.values()),
        "tissue_ml": ml,
        "glandular_fraction": count.get(Tissue.GLANDULAR, 0) / max(inside, 1),
        "nodes": len(finest.mesh.nodes),
        "tets": len(finest.mesh.tets),
        "levels": [len(level.mesh.nodes) for level in hierarchy.levels],
        "element_size_mm": hierarchy.element_size_mm,
    }
