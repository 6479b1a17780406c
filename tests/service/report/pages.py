"""A strict reader of HTML pages."""

import re
from html.parser import HTMLParser
from xml.etree import ElementTree

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Text, tags and pictures of a page; mismatched tags are an error."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.seen: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.images: list[dict[str, str]] = []
        self.pieces: list[str] = []
        self.cells: list[list[str]] = []
        self.source = source
        self.feed(source)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {name: value or "" for name, value in attrs}
        assert len(named) == len(attrs), f"<{tag}> has an attribute twice"
        self.seen.append(tag)
        self.ids += [named["id"]] if "id" in named else []
        self.addresses += [named[key] for key in ("src", "href") if key in named]
        if tag == "img":
            self.images.append(named)
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open[-1] == tag, f"</{tag}> found where </{self.open[-1]}> is due"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if {"style", "script", "svg"} & set(self.open):
            return
        self.pieces.append(data)
        if {"td", "th"} & set(self.open):
            self.cells[-1][-1] += data

    @property
    def text(self) -> str:
        """Return the visible text with single spaces."""
        return " ".join("".join(self.pieces).split())

    def row(self, first: str) -> list[str]:
        """Return the table row that starts with a text."""
        (found,) = [row for row in self.cells if row and row[0].strip() == first]
        return [" ".join(cell.split()) for cell in found]

    def drawings(self) -> list[ElementTree.Element]:
        """Return every picture, parsed; of charts drawn twice, the wide one."""
        texts = re.findall(r"<svg .*?</svg>", self.source, flags=re.DOTALL)
        parsed = [ElementTree.fromstring(text) for text in texts]
        return [one for one in parsed if "narrow" not in one.get("class", "").split()]

    def needs_no_other_file(self) -> None:
        """Check that all addresses and names are inside the page."""
        assert all(address.startswith(("data:", "#")) for address in self.addresses)
        inner = {address[1:] for address in self.addresses if address.startswith("#")}
        assert inner <= set(self.ids)
        assert len(self.ids) == len(set(self.ids))
        assert not {"link", "iframe", "object"} & set(self.seen)
        outside = re.sub(r'xmlns="[^"]*"', "", self.source)
        assert "@import" not in outside
        assert not re.search(r"url\((?!#)", outside)
        assert "http://" not in outside
        assert "https://" not in outside
        assert all(drawing.get("aria-label") for drawing in self.drawings())
