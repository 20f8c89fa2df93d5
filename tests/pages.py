"""What stands on a page, for the tests of pages."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Collects what a page refers to, its cells, its text and the data in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links, self.ids, self.cells = list[str](), list[str](), list[str]()
        self.text, self.data, self._into = "", "", ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = dict(attrs)
        self.links += [value for key in ("src", "href") if (value := names.get(key))]
        self.ids += [value for value in (names.get("id"),) if value]
        self._into = {"td": "cell", "th": "cell", "script": names.get("id") or ""}.get(tag, "")
        if self._into == "cell":
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        self._into = ""

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._into == "cell":
            self.cells[-1] += data
        elif self._into == "data":
            self.data += data
