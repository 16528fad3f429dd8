"""Writes the replay of one episode: a page, and beside it a film or a picture."""

from __future__ import annotations

import os
from pathlib import Path

from behaviors.errors import InputError, lookup
from experiments.console.notices import LOGGER
from experiments.data.exchange import as_dataset
from experiments.replay.page import MODES, write_page
from experiments.replay.pictures import check_picture, write_picture
from experiments.replay.scene import DEFAULT_PREDICTOR, chosen_entry, gather
from graphrqi.predict import PREDICTORS
from graphrqi.stream import DEFAULT_MODEL
from sim.store.dataset import open_dataset


def write_replay(
    source: Path,
    out: Path,
    *,
    episode: str | None = None,
    format: str | None = None,
    net: Path | None = None,
    labels: Path | None = None,
    model: str = DEFAULT_MODEL,
    predictor: str = DEFAULT_PREDICTOR,
    color: str | None = None,
    begin_s: float | None = None,
    end_s: float | None = None,
    picture: Path | None = None,
    quiet: bool = False,
) -> list[Path]:
    """Implement ``graphrqi replay``: write the page of an episode, and return all files written.

    Source, format and net are those of `experiments.data.exchange.as_dataset`, the episode that of
    `chosen_entry`, and labels, model and predictor those of `gather`. The colour is one of
    ``MODES``; None for the truth where it is known. The picture (.png, .pdf or .svg) or film (.mp4
    or .gif) is drawn beside the page.

    By default a page opens when the road has filled to half and there are beliefs, a film lasts as
    long as the episode, and a picture shows the fullest moment. Other times are in s.

    Raises:
        InputError: if an option or a file is wrong.
        OSError: if something cannot be written.
    """
    if color is not None:
        lookup({mode: mode for mode in MODES}, color, "color")
    if predictor != "none":
        PREDICTORS[predictor]
    wanted = [path for path in (out, picture) if path is not None]
    for path in wanted:
        if not os.access(path.parent, os.W_OK):
            raise InputError(f"{path}: found no folder {path.parent} to write to, expected one")
    if picture is not None:
        check_picture(picture)
    with as_dataset(source, format, net) as folder:
        dataset = open_dataset(folder)
        entry, many = chosen_entry(dataset, episode), len(dataset.manifest.episodes)
        if episode is None and many > 1:
            LOGGER.info("%s: showing %s, the first of %d episodes", source, entry.name, many)
        scene = gather(dataset, entry, model=model, labels=labels, predictor=predictor, quiet=quiet)
    first_s, last_s = float(scene.tracks.time_s[0]), float(scene.tracks.time_s[-1])
    if begin_s is not None and not min(first_s, 0.0) <= begin_s <= last_s:
        raise InputError(
            f"--begin-s: found {begin_s:g}, expected a time from {first_s:g} to {last_s:g} s"
        )
    mode = color or ("predicted" if scene.tracks.behavior is None else "true")
    write_page(scene, out, mode, begin_s)
    if picture is not None:
        write_picture(scene, picture, mode, begin_s, end_s, quiet)
    return wanted
