"""ASAM's formats: an episode as OpenSCENARIO and its road as OpenDRIVE (``graphrqi[asam]``)."""
