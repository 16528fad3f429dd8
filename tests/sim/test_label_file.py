"""Labels that somebody wrote: one reader, whatever the columns are called; wrong ones by line."""

from __future__ import annotations

import numpy as np
import openpyxl
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style
from sim.formats import read_recordings
from sim.formats.common.label_file import DriverLabel, read_driver_labels

TIMID = DriverLabel(Style.CONSERVATIVE, Behavior.TIMID)
RUDE = DriverLabel(Style.AGGRESSIVE)


def labels(tmp_path, text):
    path = tmp_path / "labels.csv"
    path.write_text(text)
    return read_driver_labels(path)


@pytest.mark.parametrize(
    "text",
    [
        "name,label\n3,timid\n4,aggressive\n",
        "\ufeffname,label\r\n3,timid\r\n4,aggressive\r\n",
        "Label, Name\nTimid, 3\naggressive, 4\n",
        "name,behavior,style\n3,timid,\n4,,aggressive\n",
        "name,behaviour,style\n3,timid,conservative\n4,,aggressive\n",
        "name,recording,label\n3,,timid\n4,one,aggressive\n",
    ],
)
def test_a_behaviour_or_a_style_in_any_of_these_columns(tmp_path, text):
    found = labels(tmp_path, text)
    assert found.of(["4", "5", "3"], "one", "one.csv") == [RUDE, None, TIMID]
    found.check()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,label\n3,angry\n", "line 2: label: found 'angry'"),
        ("name,label\n3,\n", "line 2: label: found ''"),
        ("name,behavior\n3,aggressive\n", "line 2: behavior: found 'aggressive'"),
        ("name,label\n3,careful\n3,timid\n", "line 3: found '3' twice"),
        ("name,label\n,timid\n", "line 2: name: found none"),
        ("name,label\n3,timid,really\n", "Expected 2 columns, got 3"),
        ("name,behavior,style\n3,timid,aggressive\n", "line 2: style: found 'aggressive'"),
        ("driver,label\n3,careful\n", "found the columns"),
        ("name,label,style\n3,careful,conservative\n", "found the columns"),
        ("name,label\n", "found no rows"),
        ("", "found the columns"),
    ],
)
def test_wrong_labels_are_refused_by_line(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        labels(tmp_path, text)


def test_sheets_beside_tracks_label_them(tmp_path):
    """Annotators of two drivers agree; on the third they do not, and nobody looked at the last."""
    rows = [f"{t},4," + ",".join(f"{9 * t + 90 * i},{40 * i},40,20,{i}" for i in range(1, 5))
            for t in range(60)]  # fmt: skip
    tracks = tmp_path / "tracks" / "VIDEO_7_gt.txt"
    tracks.parent.mkdir()
    tracks.write_text("\n".join(rows) + "\n")
    (tmp_path / "annotations").mkdir()
    sheets = {"a7": [(1, 100), (2, 1), (3, 0)], "b7": [(1, 101), (2, 3), (3, 102)]}
    for name, noted in sheets.items():
        book = openpyxl.Workbook()
        for agent, trait in noted:
            book.active.append([agent, 1, int(trait >= 100), 1, trait])
        book.save(tmp_path / "annotations" / f"{name}.xlsx")
    (read,) = read_recordings(tracks, "traf")
    behavior = dict(zip(read.tracks.names, read.tracks.behavior.tolist(), strict=True))
    assert behavior["1"] in (Behavior.IMPATIENT.code, Behavior.RECKLESS.code)
    assert behavior["2"] in [b.code for b in BEHAVIORS if b.style is Style.CONSERVATIVE]
    assert (behavior["3"], behavior["4"]) == (-1, -1)
    assert any("2 labels are resolved from the traits in a7.xlsx, b7.xlsx" in n for n in read.notes)
    for sheet in (tmp_path / "annotations").iterdir():
        sheet.rename(tracks.with_name(sheet.name))
    (beside,) = read_recordings(tracks.parent, "traf")
    np.testing.assert_array_equal(beside.tracks.behavior, read.tracks.behavior)
