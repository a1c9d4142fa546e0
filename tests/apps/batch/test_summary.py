"""Summary and page: what is written is read back, and what anybody may have named cannot break them."""

import csv
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.batch.summary import FilmStatus, Line, Summary

texts = st.text(st.characters(codec="utf-8", exclude_characters="\0\r\n"), max_size=20)
tolds = st.builds(
    FilmStatus,
    state=st.sampled_from(["waiting", "complete", "failed"]),
    error=texts,
    frames=st.none() | st.integers(0, 10**6),
    seconds=st.none() | st.integers(0, 999).map(float),
)


@given(st.dictionaries(st.text(st.characters(codec="utf-8", exclude_characters="\0\r\n"), min_size=1), tolds))
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, status: dict[str, FilmStatus]
) -> None:
    out = tmp_path_factory.mktemp("out")
    summary = Summary(out)
    lines = {source: Line(source, f"film-{n}", each) for n, (source, each) in enumerate(status.items())}
    summary.lines.update(lines)
    summary.write()
    assert Summary(out).lines == lines


def test_names_are_escaped(tmp_path: Path) -> None:
    summary = Summary(tmp_path)
    folder = tmp_path / "a b&c"  # which no batch has named
    folder.mkdir()
    (folder / "view.html").touch()
    summary.tell(Line("<script>x</script>", folder.name, FilmStatus("failed", "<b> & 'c'")))
    page = (tmp_path / "index.html").read_text()
    assert "<script" not in page
    assert "&lt;b&gt; &amp; &#39;c&#39;" in page
    assert 'href="a%20b%26c/view.html"' in page
    assert "http" not in page


def test_numbers_of_a_summary(tmp_path: Path) -> None:
    summary = Summary(tmp_path)
    summary.tell(Line("film.mp4", "film", FilmStatus("complete", "", 400, 2, 3, 12.3456789, 32.4)))
    with (tmp_path / "summary.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["seconds"] == "12.3457"
    assert (row["frames"], row["missing"], row["tracks"], row["error"]) == ("400", "2", "3", "")


@pytest.mark.parametrize(
    ("lines", "wrong"),
    [
        (
            "a.mp4,film,complete,1,0,0,1,1,\nb.mp4,film,complete,1,0,0,1,1,\n",
            "line 3: got the folder film twice",
        ),
        ("a.mp4,../elsewhere,complete,1,0,0,1,1,\n", "line 2: got 'a.mp4,../elsewhere,complete'"),
        ("a.mp4,film,done,1,0,0,1,1,\n", "line 2: got 'a.mp4,film,done'"),
        ("a.mp4,film\n", "line 2: got 'a.mp4,film,', expected a source, the name of its folder, and a state"),
        (f"a.mp4,film,failed,,,,,,{'x' * 200_000}\n", "line [12]: field larger than field limit"),
    ],
)
def test_what_no_batch_has_written_is_named(tmp_path: Path, lines: str, wrong: str) -> None:
    Summary(tmp_path).write()
    header = (tmp_path / "summary.csv").read_text()
    (tmp_path / "summary.csv").write_text(header + lines)
    with pytest.raises(ValueError, match=rf"summary\.csv, {wrong}"):
        Summary(tmp_path)
