"""The gallery of the documentation: figures of notebooks under the words of the notebook, without running one here."""

import base64

from opnav_workbench.cli import docs

PNG = b"\x89PNG made for a test"


def cell(text: str, *, shows: bytes | None = None) -> dict:
    if shows is None:
        return {"cell_type": "markdown", "source": text.splitlines(keepends=True)}
    outputs = [{"name": "stdout"}, {"data": {"image/png": base64.b64encode(shows).decode()}}]
    return {"cell_type": "code", "source": [text], "outputs": outputs}


CELLS = [
    cell("# Stars: how\n\nWhat one star\nsays.\n\nRun it."),
    cell("draw()", shows=PNG),
    cell("## By a filter\n\nWords."),
    cell("draw()", shows=PNG + b"1"),
    cell("More words, no heading."),
    cell("draw()", shows=PNG + b"2"),
]


def test_figures_stand_under_the_words_of_their_notebook(tmp_path, monkeypatch):
    (tmp_path / "pictures").mkdir()
    (tmp_path / "generated").mkdir()
    monkeypatch.setattr(docs, "_executed", lambda name: CELLS)
    docs._write_gallery(tmp_path, ("stars",), lambda _: None)
    page = (tmp_path / "generated/notebooks.md").read_text()
    assert page.startswith("## Stars: how\n\nWhat one star\nsays. (`notebooks/stars.ipynb`)\n")
    captions = ["Stars: how", "By a filter", "By a filter"]
    for number, caption in enumerate(captions):
        assert (
            f"```{{figure}} pictures/notebook_stars_{number}.png\n:alt: {caption}\n\n{caption}\n```" in page
        )
    assert (tmp_path / "pictures/notebook_stars_2.png").read_bytes() == PNG + b"2"
