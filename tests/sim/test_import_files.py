"""Which files of a folder are read, however they are called and begin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.data.exchange import import_recordings
from sim.formats import left_out_files, read_recordings, recording_files
from sim.frames import KINDS, AgentKind
from tests.sim.test_formats import (
    IND,
    INTERACTION,
    NGSIM_CSV,
    NGSIM_HEADER,
    NGSIM_ROW,
    NGSIM_ROWS,
)

IND_BROKEN = IND.replace("xCenter", "xCentre")


def test_others_with_a_common_ending_are_left_out_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (source / "I80.CSV").write_text(NGSIM_CSV)
    (source / "notes.csv").write_text("who,what\n")
    manifest = import_recordings(source, tmp_path / "out", quiet=True)
    assert len(manifest.episodes) == 1
    assert "left out, because they are not in the format ngsim: notes.csv" in caplog.text
    assert "notes.csv" in (tmp_path / "out" / "README.md").read_text()


def test_types_beside_sumo_recordings_are_not_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text('<fcd-export><timestep time="0"/></fcd-export>')
    (tmp_path / "a.types.xml").write_text("<additional/>")
    assert [file.name for file in recording_files(tmp_path, "sumo-fcd")] == ["a.xml"]
    assert left_out_files(tmp_path, ["sumo-fcd"]) == []


def test_ngsim_is_told_by_its_content_not_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "header.txt").write_text(NGSIM_CSV)
    (tmp_path / "rows.csv").write_text(NGSIM_ROWS)
    header, rows = read_recordings(tmp_path, "ngsim")
    np.testing.assert_array_equal(header.tracks.xy, rows.tracks.xy)


def _ngsim_rows(start_ms: int, vehicles: int, frames: int, length_ft: float) -> list[str]:
    return [
        NGSIM_ROW.format(frame=frame, time=start_ms + 100 * frame, y=10 * vehicle + frame)
        .replace("2224", str(vehicle), 1)
        .replace("14.3", str(length_ft))
        .replace(" ", ",")
        .strip()
        for vehicle in range(vehicles)
        for frame in range(frames)
    ]


def test_ngsim_periods_apart_are_recordings_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = _ngsim_rows(0, 2, 50, 15.0) + _ngsim_rows(900_000, 2, 50, 40.0)
    path.write_text("\n".join([NGSIM_HEADER, *rows, ""]))
    first, second = read_recordings(path)
    assert (first.name, second.name) == ("a-1", "a-2")
    for recording, feet in ((first, 15.0), (second, 40.0)):
        assert recording.tracks.time_s[-1] == pytest.approx(4.9)
        np.testing.assert_allclose(recording.tracks.length, feet * 0.3048)


def test_an_id_that_comes_again_after_long_is_another_vehicle(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    all_the_time = [row.replace("0,", "9,", 1) for row in _ngsim_rows(0, 1, 1900, 15.0)]
    rows = all_the_time + _ngsim_rows(0, 1, 5, 15.0) + _ngsim_rows(180_000, 1, 5, 40.0)
    path.write_text("\n".join([NGSIM_HEADER, *rows, ""]))
    (recording,) = read_recordings(path)
    assert recording.tracks.names == ("0", "9", "0/2")
    np.testing.assert_allclose(recording.tracks.length, np.array([15, 15, 40]) * 0.3048)


def test_cases_of_one_interaction_file_are_recordings_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "vehicle_tracks_000.csv"
    header, *rows = INTERACTION.strip().splitlines()
    cases = [f"{case}.0,{row}" for case in (1, 2) for row in rows]
    path.write_text("\n".join([f"case_id,{header}", *cases, ""]))
    first, second = read_recordings(path)
    assert (first.name, second.name) == ("vehicle_tracks_000-1.0", "vehicle_tracks_000-2.0")
    np.testing.assert_array_equal(first.tracks.xy, second.tracks.xy)


def test_a_vehicle_and_a_person_may_have_one_name(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    agent = '<{} id="0" x="{}" y="0" angle="90" speed="1" type="t"/>'
    both = agent.format("vehicle", 10) + agent.format("person", 50)
    empty = '<timestep time="0.1"/>'
    path.write_text(
        f'<fcd-export><timestep time="0">{both}</timestep>{empty}<timestep time="0.2">{both}'
        "</timestep></fcd-export>"
    )
    (recording,) = read_recordings(path)
    assert recording.tracks.names == ("0", "person-0")
    assert [KINDS[code] for code in recording.tracks.kind] == [
        AgentKind.CAR, AgentKind.PEDESTRIAN
    ]  # fmt: skip
    assert recording.tracks.time_s.tolist() == [0.0, 0.1, 0.2]
    assert recording.tracks.valid.sum(axis=0).tolist() == [2, 0, 2]


def test_a_failed_import_leaves_nothing_and_may_be_tried_again(tmp_path: Path) -> None:
    source, out = tmp_path / "source", tmp_path / "deep" / "out"
    source.mkdir()
    for number, content in enumerate((IND, IND, IND_BROKEN)):
        (source / f"0{number}_tracks.csv").write_text(content)
    with pytest.raises(InputError, match="02_tracks"):
        import_recordings(source, out, quiet=True)
    assert not out.exists()
    out.mkdir(parents=True)
    with pytest.raises(InputError, match="02_tracks"):
        import_recordings(source, out, quiet=True)
    assert list(out.iterdir()) == []
    (source / "02_tracks.csv").write_text(IND)
    assert len(import_recordings(source, out, quiet=True).episodes) == 3
