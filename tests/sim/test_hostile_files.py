"""Files of recordings that were made to break a reader: refused in one line, or read whole."""

from __future__ import annotations

import gzip
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from sim.formats import get_reader

ARGO1 = "TIMESTAMP,CITY_NAME,TRACK_ID,OBJECT_TYPE,X,Y\n"
NGSIM = "Vehicle_ID,Total_Frames,Global_Time,Local_X,Local_Y,v_length,v_Width,v_Class,v_Vel\n"
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


def sparse_csv(n: int) -> str:
    return ARGO1 + "".join(f"{i / 10},PIT,{i},OTHERS,{i},0\n" for i in range(n))


def sparse_ngsim(n: int) -> str:
    return NGSIM + "".join(f"{i},1,{100 * i},1,{i},15,6,2,3\n" for i in range(n))


def sparse_fcd(n: int) -> str:
    steps = "".join(
        f'<timestep time="{i}"><vehicle id="a{i}" x="{i}" y="0" angle="90" speed="1"/></timestep>'
        for i in range(n)
    )
    return f"<fcd-export>{steps}</fcd-export>"


@pytest.mark.parametrize(
    ("file", "make"),
    [("a.csv", sparse_csv), ("b.csv", sparse_ngsim), ("c.xml", sparse_fcd)],
)
def test_agents_seen_once_each_take_no_gigabytes(
    tmp_path: Path, file: str, make: Callable[[int], str]
) -> None:
    path = put(tmp_path, file, make(10_000))
    script = (
        "import resource, sys; from pathlib import Path; from sim.formats import read_recordings\n"
        "resource.setrlimit(resource.RLIMIT_AS, (int(3.5e9), int(3.5e9)))\n"
        "rows = sum(r.tracks.as_rows().speed.size for r in read_recordings(Path(sys.argv[1])))\n"
        "status = Path('/proc/self/status').read_text()\n"
        "print(rows, status.split('VmHWM:')[1].split()[0])"  # getrusage begins at the parent's peak
    )
    done = subprocess.run(
        [sys.executable, "-c", script, path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-300:]
    rows, peak_kb = map(int, done.stdout.split())
    assert rows == 10_000
    assert peak_kb * 1024 < 1e9


def test_a_recording_in_pixels_is_cut_in_time_where_it_does_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [f"{k},1,{k},20,8,5,{k}" for k in range(40)]
    path = put(tmp_path, "a_gt.txt", "\n".join([*lines, ""]))
    (whole,) = get_reader("traf")(path)
    monkeypatch.setattr("sim.formats.traf.MAX_CELLS", 100)
    parts = list(get_reader("traf")(path))
    assert [part.name for part in parts] == ["a_gt-1", "a_gt-2", "a_gt-3", "a_gt-4"]
    assert "cut into 4 recordings" in parts[0].notes[-1]
    names = [name for part in parts for name in part.tracks.names]
    assert names == list(whole.tracks.names)
    x = np.concatenate([part.tracks.xy[part.tracks.valid] for part in parts])[:, 0]
    np.testing.assert_array_equal(x, np.arange(40.0) + 4.0)


def test_many_boxes_of_one_id_are_refused(tmp_path: Path) -> None:
    boxes = ",".join(f"{i},10,20,10,7" for i in range(6000))
    path = put(tmp_path, "a_gt.txt", f"0,6000,{boxes}\n1,6000,{boxes}\n")
    assert refused(path, "traf") == "line 1: found more than 32 boxes of id 7, expected one"


@pytest.mark.parametrize("file", ["a.xml.gz", "a.csv.gz"])
def test_a_packed_file_that_is_far_larger_inside_is_refused(tmp_path: Path, file: str) -> None:
    content = (sparse_fcd(1) if "xml" in file else ARGO1).encode() + b" " * (2**26 + 10)
    path = put(tmp_path, file, gzip.compress(content))
    assert "found more than 67108864 bytes inside" in refused(
        path, "sumo-fcd" if "xml" in file else "argoverse1"
    )


@pytest.mark.parametrize("at", [5, 12, 40, -1, -6])
@pytest.mark.parametrize("cut", [False, True])
def test_damaged_packed_files_are_refused(tmp_path: Path, at: int, cut: bool) -> None:
    data = bytearray(gzip.compress(sparse_fcd(30).encode(), mtime=0))
    if cut:
        del data[at:]
    elif at == 5:
        data[0] ^= 4
    else:
        data[at] ^= 0x55
    path = put(tmp_path, "a.xml.gz", bytes(data))
    assert refused(path, "sumo-fcd")


# --- silent loss --------------------------------------------------------------------------------


def rows_of(*lines: str) -> str:
    return ARGO1 + "".join(f"{line}\n" for line in lines)


def test_an_open_quotation_mark_joins_no_lines(tmp_path: Path) -> None:
    lines = [f"{i / 10},PIT,a,AGENT,{i},0" for i in range(10)]
    for i in (3, 7):
        lines[i] = lines[i].replace("PIT", '"PIT')
    path = put(tmp_path, "a.csv", rows_of(*lines))
    assert refused(path, "argoverse1").startswith("line 5: found a quotation mark")


@pytest.mark.parametrize("city", ['P"I"T', '"PIT"x', 'x"PIT"', '"P"I"T"', '"', '"""'])
def test_misplaced_quotation_marks_are_refused(tmp_path: Path, city: str) -> None:
    path = put(tmp_path, "a.csv", rows_of("0.0,PIT,a,AGENT,0,0", f"0.1,{city},a,AGENT,1,0"))
    assert refused(path, "argoverse1").startswith("line 3: found a quotation mark")


@pytest.mark.parametrize("city", ['"PIT"', '""', '"P,IT"', '"P""I""T"', '"""PIT"""'])
def test_quotation_marks_around_a_field_are_read(tmp_path: Path, city: str) -> None:
    path = put(tmp_path, "a.csv", rows_of("0.0,PIT,a,AGENT,0,0", f"0.1,{city},a,AGENT,1,0"))
    (recording,) = get_reader("argoverse1")(path)
    assert recording.tracks.xy[0, :, 0].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (b"0.1,PIT,a,AGENT,1_0,0", "column x, row 3: found '1_0', expected a number"),
        ("0.1,PIT,a,AGENT,\uff11,0".encode(), "column x, row 3: found '\uff11', expected a number"),
        (b"0.1,PIT,a,AGENT,,0", "column x, row 3: found '', expected a number"),
        (b"0.1,PIT,a,AGENT,1", "row 3: found 5 fields, expected 6"),
        (b"0.1,PIT,a\xff,AGENT,1,0", "row 3: found bytes that are not UTF-8"),
        (b"0.1,PIT,a\0,AGENT,1,0", "line 3: found a NUL byte, expected text"),
    ],
)
def test_a_broken_row_is_named(tmp_path: Path, line: bytes, found: str) -> None:
    path = put(tmp_path, "a.csv", rows_of("0.0,PIT,a,AGENT,0,0").encode() + line + b"\n")
    assert refused(path, "argoverse1") == found


@pytest.mark.parametrize("number", ["1_0", "\uff11", "nan", "1e999"])
@pytest.mark.parametrize("name", ["sumo-fcd", "ngsim", "traf"])
def test_numbers_that_only_python_reads_are_refused(tmp_path: Path, name: str, number: str) -> None:
    row = "7 1 5 100 {} 2 3 4 15 6 2 3 0 1 0 0 0 0\n"
    fcd = '<fcd-export><timestep time="0"><vehicle id="a" x="{}" y="0" angle="0" speed="1"/>'
    text = {
        "sumo-fcd": fcd + "</timestep></fcd-export>",
        "ngsim": row,
        "traf": "0,1,{},1,10,10,1\n",
    }[name].format(number)
    refused(put(tmp_path, {"sumo-fcd": "a.xml"}.get(name, "a.txt"), text), name)


def test_a_vehicle_after_its_timestep_is_refused(tmp_path: Path) -> None:
    vehicle = '<vehicle id="{}" x="1" y="0" angle="0" speed="1"/>'
    text = (
        f'<fcd-export><timestep time="0">{vehicle.format("a")}</timestep>{vehicle.format("b")}'
        "</fcd-export>"
    )
    assert "found a vehicle outside of a timestep" in refused(
        put(tmp_path, "a.xml", text), "sumo-fcd"
    )


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
    with pytest.raises(InputError, match=f"{facts.name}: found agent '1' more than once"):
        list(get_reader("ind")(path))
    put(tmp_path, "00_tracksMeta.csv", "trackId,class\n1,car\n")
    put(tmp_path, "00_recordingMeta.csv", "frameRate\n25\n10\n")
    with pytest.raises(InputError, match="found 10 and 25, expected one"):
        list(get_reader("ind")(path))


def test_thousands_of_tiny_cases_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"{i},1,1,100,car,0,0,1,0\n{i},1,2,200,car,1,0,1,0\n" for i in range(500))
    path = put(tmp_path, "vehicle_tracks_000.csv", f"{INTERACTION}\n{rows}")
    assert refused(path, "interaction").startswith("column case_id: found 500 cases in 1000 rows")


def test_hundreds_of_places_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"{i},1,100,1,1,15,6,2,3,place{i}\n" for i in range(101))
    path = put(tmp_path, "a.csv", NGSIM.rstrip() + ",Location\n" + rows)
    assert refused(path, "ngsim").startswith("column location: found 101 places")
