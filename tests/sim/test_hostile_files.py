"""Files of recordings that were made to break a reader: refused in one line, or read whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from behaviors.errors import InputError
from sim.formats import get_reader

ARGO1 = "TIMESTAMP,CITY_NAME,TRACK_ID,OBJECT_TYPE,X,Y\n"
INTERACTION = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy"


def refused(path: Path, name: str) -> str:
    with pytest.raises(InputError) as caught:
        list(get_reader(name)(path))
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{path}: ")


def put(folder: Path, name: str, text: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


# --- memory -------------------------------------------------------------------------------------


def test_many_boxes_of_one_id_are_refused(tmp_path: Path) -> None:
    boxes = ",".join(f"{i},10,20,10,7" for i in range(6000))
    path = put(tmp_path, "a_gt.txt", f"0,6000,{boxes}\n1,6000,{boxes}\n")
    assert refused(path, "traf") == "line 1: found more than 32 boxes of id 7, expected one"


# --- silent loss --------------------------------------------------------------------------------


def rows_of(*lines: str) -> str:
    return ARGO1 + "".join(f"{line}\n" for line in lines)


def test_an_open_quotation_mark_joins_no_lines(tmp_path: Path) -> None:
    lines = [f"{i / 10},PIT,a,AGENT,{i},0" for i in range(10)]
    for i in (3, 7):
        lines[i] = lines[i].replace("PIT", '"PIT')
    path = put(tmp_path, "a.csv", rows_of(*lines))
    assert refused(path, "argoverse1").startswith("line 5: found a quotation mark")


@pytest.mark.parametrize("city", ['"PIT"', '""', '"P,IT"', '"P""I""T"', '"""PIT"""'])
def test_quotation_marks_around_a_field_are_read(tmp_path: Path, city: str) -> None:
    path = put(tmp_path, "a.csv", rows_of("0.0,PIT,a,AGENT,0,0", f"0.1,{city},a,AGENT,1,0"))
    (recording,) = get_reader("argoverse1")(path)
    assert recording.tracks.xy[0, :, 0].tolist() == [0.0, 1.0]


def test_sizes_are_read_where_headings_are_missing(tmp_path: Path) -> None:
    rows = "1,1,100,car,0,0,1,0,9.5,2.5\n1,2,200,car,1,0,1,0,9.5,2.5\n"
    text = f"{INTERACTION[8:]},length,width\n{rows}"
    path = put(tmp_path, "vehicle_tracks_000.csv", text)
    (recording,) = get_reader("interaction")(path)
    assert (recording.tracks.length[0], recording.tracks.width[0]) == (9.5, 2.5)


def test_an_agent_of_two_types_is_refused(tmp_path: Path) -> None:
    text = f"{INTERACTION[8:]}\n1,1,100,car,0,0,1,0\n1,2,200,truck,1,0,1,0\n"
    path = put(tmp_path, "vehicle_tracks_000.csv", text)
    assert refused(path, "interaction") == (
        "column agent_type, row 3: found 'truck', expected 'car' as in the agent's first row"
    )


def test_contradicting_rows_of_metadata_are_refused(tmp_path: Path) -> None:
    header = "recordingId,trackId,frame,xCenter,yCenter,heading,width,length,xVelocity,yVelocity\n"
    path = put(tmp_path, "00_tracks.csv", f"{header}0,1,0,0,0,0,2,4,1,0\n")
    facts = put(tmp_path, "00_tracksMeta.csv", "trackId,class\n1,car\n1,bus\n")
    with pytest.raises(InputError, match=f"{facts.name}: column class, row 3: found 'bus'"):
        list(get_reader("ind")(path))
    put(tmp_path, "00_tracksMeta.csv", "trackId,class\n1,car\n")
    put(tmp_path, "00_recordingMeta.csv", "frameRate\n25\n10\n")
    with pytest.raises(InputError, match="found 10 and 25, expected one"):
        list(get_reader("ind")(path))
