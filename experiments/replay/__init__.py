"""Replays: one episode as a page that plays in a browser, as a video or as a picture."""

from __future__ import annotations

from pathlib import Path

from behaviors.errors import InputError, lookup
from experiments.exchange import as_dataset
from experiments.replay.page import MODES, write_page
from experiments.replay.scene import chosen_entry, gather
from graphrqi.predict import get_predictor
from sim.dataset import open_dataset


def write_replay(
    source: Path,
    out: Path,
    *,
    episode: str | None = None,
    labels: Path | None = None,
    predictions: Path | None = None,
    format: str | None = None,
    net: Path | None = None,
    model: str = "graphrqi-plus",
    predictor: str = "graphrqi-predict",
    color: str | None = None,
    at_s: float | None = None,
) -> None:
    """What ``graphrqi replay`` does.

    Args:
        source: a dataset or a recording.
        out: the HTML file.
        episode: the beginning of an episode's id; None for the first.
        labels: a labels file; None to classify with ``model``.
        predictions: a predictions file; None to predict with ``predictor``.
        format: format of a recording; None to tell it from the content.
        net: the SUMO net that a recording was made on.
        model: a shipped model's name or a folder.
        predictor: a key of ``PREDICTORS``, or "none".
        color: what agents are coloured by at first, one of ``MODES``; None for the truth where it
            is known.
        at_s: the time at which the page opens, s; None for the beginning.

    Raises:
        InputError: if an option or a file is wrong.
        OSError: if the page cannot be written.
    """
    if color is not None:
        lookup({mode: mode for mode in MODES}, color, "color")
    if predictor != "none":
        get_predictor(predictor)
    if not out.parent.is_dir():
        raise InputError(f"{out}: found no folder {out.parent}, expected one")
    with as_dataset(source, format, net) as folder:
        dataset = open_dataset(folder)
        scene = gather(
            dataset, chosen_entry(dataset, episode), model=model, labels=labels,
            predictions=predictions, predictor=predictor,
        )  # fmt: skip
    write_page(scene, out, color, at_s)
