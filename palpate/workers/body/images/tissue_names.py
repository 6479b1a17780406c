"""Tissues by the names that users and programs give to segments."""

import re

from palpate.storage.values import Tissue

_WORDS = {
    Tissue.AIR: "air background exterior outside clear",
    Tissue.FAT: "fat adipose fatty lipid",
    Tissue.GLANDULAR: "gland glands glandular fibroglandular fibro fgt parenchyma",
    Tissue.SKIN: "skin cutis dermis epidermis",
    Tissue.MUSCLE: "muscle muscles pectoral pectorals pectoralis",
    Tissue.LIGAMENT: "ligament ligaments cooper coopers",
}
_TISSUE = {word: tissue for tissue, words in _WORDS.items() for word in words.split()}
_SILENT = (
    "tissue tissues breast breasts mammary left right l r the of s label mask segment "
    "subcutaneous skeletal torso intermuscular major minor suspensory chest wall"
)
_NEUTRAL = set(_SILENT.split())


def tissue_in(name: str) -> Tissue | None:
    """Return the tissue described by a name; None if that is uncertain.

    Words count, in any case: at least one names a tissue, all tissue words name the same one, and
    all other words are neutral ("left", "breast", "tissue", numbers).

    Examples
    --------
    >>> tissue_in("Fibroglandular tissue (left)")
    <Tissue.GLANDULAR: 2>
    >>> tissue_in("fat and skin") is None
    True
    """
    words = [word for word in re.findall(r"[^\W\d_]+", name.lower()) if word not in _NEUTRAL]
    tissues = {_TISSUE.get(word) for word in words}
    return tissues.pop() if len(tissues) == 1 else None
