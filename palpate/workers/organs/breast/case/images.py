"""Images of a case as tissues: files in its folder, or volumes in the store."""

from collections.abc import Callable, Mapping
from pathlib import Path

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.labels import label_counts, relabel, tissue_named
from palpate.workers.body.images.named_labels import label_tissues
from palpate.workers.body.images.read import LabelImage, read_labels
from palpate.workers.input_files import named_by
from palpate.workers.organs.breast.case.spec import CaseScans

StoredVolume = Callable[[str], Volume | None]
"""Returns a stored volume by its name."""
USUAL = {0: "air", 1: "fat", 2: "glandular"}
NEEDED = {Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR}
# Skin counts as fat unless the model includes it.
COUNTED_AS = {Tissue.SKIN: Tissue.FAT}


def no_store(name: str) -> Volume | None:
    """Return None, as there is no store."""
    return None


class CaseImages:
    """The images named in a case.

    Parameters
    ----------
    case : Path
        The file of the case.
    scans : CaseScans
        Settings for reading its images.
    stored : callable
        Finds volumes in the store.
    """

    def __init__(self, case: Path, scans: CaseScans, stored: StoredVolume) -> None:
        self.case, self.scans, self.stored = case, scans, stored

    def tissues(self, name: str) -> Volume:
        """Return an image as air, fat and glandular tissue.

        Raises
        ------
        InputError
            If there is no such image, or a label is not a tissue of a diagnosis.
        """
        image = self._image(name)
        found = self._understood(image)
        known = {label: COUNTED_AS.get(tissue, tissue) for label, tissue in found.items()}
        others = [tissue.name.lower() for tissue in known.values() if tissue not in NEEDED]
        if others:
            raise InputError(
                f"{image.where} has {' and '.join(others)}, but a diagnosis has only air, fat and "
                "glandular tissue. Assign it to one of them, as in labels: {NAME: fat}."
            )
        if set(known.values()) != NEEDED:
            raise InputError(self._missing(image))
        return relabel(image.volume, known)

    def _image(self, name: str) -> LabelImage:
        path = named_by(self.case, name)
        scans = self.scans
        if path.exists():
            return read_labels(path, spacing_mm=scans.spacing_mm, axes=scans.axes)
        volume = self.stored(name)
        if volume is None:
            raise InputError(
                f"{self.case} names {name}, which is neither in the folder nor in the store. "
                "Check the name, or import the image first."
            )
        if scans.axes is not None or scans.spacing_mm is not None:
            raise InputError(
                f"{name} is a stored volume, whose spacing and axes are known: remove axes and "
                f"spacing_mm from {self.case}, or name the file."
            )
        names = {int(t): t.name.lower() for t in Tissue}
        return LabelImage(volume, names, f"The stored volume {name}", anatomical=False)

    def _understood(self, image: LabelImage) -> dict[int, Tissue]:
        stated = self.scans.labels
        if isinstance(stated, str):
            return label_tissues(image, str(named_by(self.case, stated)))
        if image.names:
            return label_tissues(image, stated)
        meanings = USUAL if stated is None else label_tissues(image, stated)
        found = label_counts(image.volume)
        if not found.keys() <= meanings.keys():
            raise InputError(self._missing(image))
        return {label: tissue_named(meanings[label]) for label in found}

    def _missing(self, image: LabelImage) -> str:
        return (
            f"{image.where} has the labels {sorted(label_counts(image.volume))}; a case needs 0 "
            f"background, 1 fat and 2 glandular, or the labels given in {self.case.name}. "
            "Relabel the scan, or segment the missing tissues."
        )


def labels_in_words(labels: Mapping[int | str, str] | Mapping[int, str] | str | None) -> str:
    """Describe the labels given in a case, for a table."""
    if isinstance(labels, str):
        return f"named by {labels}"
    if labels is None:
        return f"by the names in the files, or {labels_in_words(USUAL)}"
    return ", ".join(f"{label} {tissue}" for label, tissue in labels.items())
