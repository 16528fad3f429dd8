"""Replays: one episode as a page that plays in a browser, as a video or as a picture."""
