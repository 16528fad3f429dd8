"""The road of a recording, checked against where its vehicles move before anything uses it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from behaviors.errors import InputError
from experiments.console.notices import LOGGER
from sim.formats.common.recording import Recording
from sim.road import Road
from sim.road.files import read_road_file
from sim.road.map_fit import LEAST, MapFit, map_fit, shifted


class RecordedRoads:
    """The roads of recordings that are read one after another.

    A map that came with a recording and does not fit it is left out, and named once in the log. One
    that a person gave is refused by name, unless too few vehicles move to blame it.

    Args:
        net: the map that a person gave for all recordings; None for what comes with each.

    Raises:
        InputError: if ``net`` is no map.
    """

    def __init__(self, net: Path | None = None) -> None:
        self._net = net
        self._fitted = 0
        self._refused: dict[str, str] = {}
        if net is not None:
            read_road_file(net)

    def of(self, recording: Recording) -> tuple[Path | Road | None, tuple[str, ...]]:
        """The road that a recording is stored with, and what was found about it.

        Args:
            recording: what was read.

        Returns:
            The map's file where it is used as it is and datasets keep such files; the road where
            it comes from inside the recording, was shifted, or its limits do not rule; None
            without one, or where it does not fit. And one sentence for each finding.

        Raises:
            InputError: if the map that a person gave is of another place.
        """
        given: Path | Road | None = recording.road if self._net is None else self._net
        if given is None:
            return None, ()
        read = given if isinstance(given, Road) else read_road_file(given, origin=recording.origin)
        fit = map_fit(read, recording.tracks)
        if fit.fits:
            self._fitted += 1
            return _kept(given, read, fit), fit.notes()
        told = (
            f"{read.source}: found {fit.shifted_share:.0%} of the moving positions of "
            f"{recording.name} inside its lanes, expected at least {LEAST:.0%} as on a map of the "
            "same place"
        )
        if self._net is not None and fit.sure:
            raise InputError(told)
        if str(read.source) not in self._refused:
            LOGGER.warning("%s: left out", told)
            self._refused[str(read.source)] = told
        return None, (f"{told}: left out",)

    def check(self) -> None:
        """Refuse a map that a person gave and that fitted no recording at all.

        Raises:
            InputError: naming it.
        """
        if self._net is not None and self._refused and not self._fitted:
            raise InputError(next(iter(self._refused.values())))


def _kept(given: Path | Road, read: Road, fit: MapFit) -> Path | Road:
    """What to store: the file if nothing about the map changes and datasets keep such files."""
    rules = fit.limits_rule and read.knows.limits_rule
    if fit.shift_m == (0.0, 0.0) and rules == read.knows.limits_rule:
        keeps = isinstance(given, Path) and given.name.endswith((".json", ".net.xml"))
        return given if keeps else read
    knows = dataclasses.replace(read.knows, limits_rule=rules)
    return dataclasses.replace(shifted(read, fit.shift_m), knows=knows)
