"""The road of a recording, checked against where its vehicles move before anything uses it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

from behaviors.errors import InputError
from experiments.console.notices import LOGGER
from experiments.guard import guarded_call
from sim.formats.common.recording import Recording
from sim.road import Road
from sim.road.files import read_road_file
from sim.road.map_fit import LEAST, map_fit, shifted
from sim.road.net import net_offset


class RecordedRoads:
    """The roads of recordings that are read one after another.

    A map that came with a recording and does not fit it is left out, and named once in the log. One
    that a person gave as ``net`` is refused by name, unless too few vehicles move to blame it. All
    maps are moved by ``shift_m``, m.
    """

    def __init__(self, net: Path | None = None, shift_m: tuple[float, float] | None = None) -> None:
        self._net = net
        self._shift_m = shift_m
        self._fitted = 0
        self._refused: dict[str, str] = {}
        self._said: set[str] = set()
        if net is not None:
            guarded_call(net, read_road_file, net)

    def of(self, recording: Recording) -> tuple[Path | Road | None, tuple[str, ...]]:
        """The road that a recording is stored with, and one sentence for each finding about it.

        The road is the map's file where it is used unchanged and datasets keep such files; None
        without a map, or where it does not fit.

        Raises:
            InputError: if the map that a person gave is of another place.
        """
        given: Path | Road | None = recording.road if self._net is None else self._net
        if given is None:
            return None, ()
        road = given
        if isinstance(road, Path):  # readers of recordings, or this class, have read it before
            road = read_road_file(road, origin=recording.origin)
        notes: tuple[str, ...] = ()
        if self._shift_m is not None:
            road = shifted(road, self._shift_m)
            notes = ("the map is shifted by ({:g}, {:g}) m".format(*self._shift_m),)
        for text in set(road.doubts) - self._said:
            LOGGER.warning("%s: %s", road.source, text)
        self._said |= set(road.doubts)
        notes += road.doubts
        fit = map_fit(road, recording.tracks)
        if not fit.fits and self._shift_m is None and isinstance(given, Path):
            offset = net_offset(given)
            moved = shifted(road, (-offset[0], -offset[1]))
            there = map_fit(moved, recording.tracks)
            if any(offset) and there.fits and not math.isnan(there.share):
                road, fit = moved, there
                by = f"({-offset[0]:g}, {-offset[1]:g})"
                notes = (f"the map is shifted by {by} m, as its own offset says",)
                LOGGER.warning("%s: %s", road.source, notes[0])
        if recording.own_road and self._net is None:
            fit = dataclasses.replace(fit, vehicles=0)  # it belongs to it by its id
        if not fit.fits:
            found = (
                f"{road.source}: the map does not fit the positions: found {fit.share:.0%} of the "
                f"moving ones of {recording.name} inside its lanes, expected at least {LEAST:.0%}, "
                "or import --shift X,Y"
            )
            if self._net is not None and fit.sure:
                raise InputError(found)
            if str(road.source) not in self._refused:
                LOGGER.warning("%s: left out", found)
                self._refused[str(road.source)] = found
            return None, (f"{found}: left out",)
        self._fitted += 1
        keeps = isinstance(given, Path) and given.name.endswith((".json", ".net.xml"))
        if fit.limits_rule and keeps and not notes:
            return given, fit.notes()
        rules = fit.limits_rule and road.knows.limits_rule
        knows = dataclasses.replace(road.knows, limits_rule=rules)
        return dataclasses.replace(road, knows=knows), (*notes, *fit.notes())

    def check(self) -> None:
        """Refuse a map that a person gave and that fitted no recording at all."""
        if self._net is not None and self._refused and not self._fitted:
            raise InputError(next(iter(self._refused.values())))
