"""Replays: one episode as a page that plays in a browser, as a video or as a picture."""

from __future__ import annotations

from pathlib import Path

from behaviors.errors import InputError, lookup
from experiments.data.exchange import as_dataset
from experiments.replay.page import MODES, default_mode, write_page
from experiments.replay.picture import write_picture
from experiments.replay.scene import chosen_entry, gather
from experiments.replay.video import check_video, write_video
from graphrqi.predict import get_predictor
from sim.store.dataset import open_dataset


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
    predictor: str | None = None,
    color: str | None = None,
    begin_s: float | None = None,
    end_s: float | None = None,
    video: Path | None = None,
    picture: Path | None = None,
    quiet: bool = False,
) -> list[Path]:
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
        predictor: a key of ``PREDICTORS``, or "none" for no predictions; None for the default one,
            or for the first in ``predictions``.
        color: what agents are coloured by at first, one of ``MODES``; None for the truth where it
            is known.
        begin_s: when the page opens, a film begins, or a picture was taken, s; None for: when
            the road has filled to half, the beginning, the fullest moment.
        end_s: when a film ends, s; None for the end.
        video: also film it into this file, .mp4 or .gif.
        picture: also draw it into this file, .png.
        quiet: whether to show no progress.

    Returns:
        What was written.

    Raises:
        InputError: if an option or a file is wrong.
        OSError: if something cannot be written.
    """
    if color is not None:
        lookup({mode: mode for mode in MODES}, color, "color")
    if predictor is not None and predictor != "none":
        get_predictor(predictor)
    wanted = [path for path in (out, video, picture) if path is not None]
    for path in wanted:
        if not path.parent.is_dir():
            raise InputError(f"{path}: found no folder {path.parent}, expected one")
    if video is not None:
        check_video(video)
    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"--picture: found {picture.name!r}, expected a name that ends in .png")
    with as_dataset(source, format, net) as folder:
        dataset = open_dataset(folder)
        scene = gather(
            dataset, chosen_entry(dataset, episode), model=model, labels=labels,
            predictions=predictions, predictor=predictor, quiet=quiet,
        )  # fmt: skip
    first_s, last_s = float(scene.tracks.time_s[0]), float(scene.tracks.time_s[-1])
    if begin_s is not None and not min(first_s, 0.0) <= begin_s <= last_s:
        raise InputError(
            f"--begin-s: found {begin_s:g}, expected a time from {first_s:g} to {last_s:g} s"
        )
    mode = color or default_mode(scene)
    write_page(scene, out, mode, begin_s)
    if video is not None:
        write_video(scene, video, mode, begin_s, end_s, quiet)
    if picture is not None:
        write_picture(scene, picture, mode, begin_s)
    return wanted
